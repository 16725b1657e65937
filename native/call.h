/* What all files of the extension know: the functions of the native library, see `call.c`. */

#ifndef LOEWNER_CALL_H
#define LOEWNER_CALL_H

#define PY_SSIZE_T_CLEAN
#define NPY_NO_DEPRECATED_API NPY_1_23_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL loewner_array_api
#ifndef HOLDS_ARRAY_API /* one file imports NumPy for all */
#define NO_IMPORT_ARRAY
#endif
#include <Python.h>
#include <numpy/arrayobject.h>
#include <stdint.h>

#define MOST_WORDS 32 /* arguments of a kernel */

typedef int32_t (*Function)(const int64_t *, int64_t *);

typedef struct {
    char kind; /* i, f or b for a number; A for an array */
    char constant;
    int type, axes;
} Word;

typedef struct {
    PyObject_HEAD
    vectorcallfunc vectorcall;
    Function function;
    void (*release)(void *);
    PyObject *library, *name;
    int arguments, results;
    Word argument[MOST_WORDS], result[MOST_WORDS];
} Kernel;

extern PyTypeObject KernelType, LibraryType;

/* Read words as `loewner/_native/entries.py` describes them; how many, or -1 with an exception. */
int read_words(const char *text, Word *words, int most);

#endif
