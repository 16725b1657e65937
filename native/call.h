/* Calls of functions in the native library, for all files of the extension; see `call.c`. */

#ifndef LOEWNER_CALL_H
#define LOEWNER_CALL_H

/* Use only names and layouts that Python 3.11 and all later versions share, so that one file serves all of them. */
#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#define NPY_NO_DEPRECATED_API NPY_1_23_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL loewner_array_api
#ifndef HOLDS_ARRAY_API /* One file imports NumPy for all files. */
#define NO_IMPORT_ARRAY
#endif
#include <Python.h>
#include <numpy/arrayobject.h>
#include <stdint.h>

#define MOST_WORDS 32 /* A kernel has at most MOST_WORDS arguments. */

typedef int32_t (*Function)(const int64_t *, int64_t *);

typedef struct {
    char kind; /* The kind of a number is i, f or b; the kind of an array is A. */
    char constant;
    int type, axes;
} Word;

typedef struct {
    PyObject_HEAD
    /* The built-in function that calls the kernel from Python has this definition, see `library_kernel`. */
    PyMethodDef definition;
    Function function;
    void (*release)(void *);
    PyObject *library, *name;
    char symbol[128];
    int arguments, results;
    Word argument[MOST_WORDS], result[MOST_WORDS];
} Kernel;

#define FAST_METHOD(name, function, text) {name, (PyCFunction)(void (*)(void))(function), METH_FASTCALL, text}

/* Make a type, and add it to a module under the last part of its name; return a new reference, or NULL. */
PyTypeObject *add_type(PyObject *module, PyType_Spec *spec);

/* Make an object of a type, with all fields zero; return NULL, with an exception, if this fails. */
void *new_object(PyTypeObject *type);

/* Free the memory of an object. */
void free_object(PyObject *object);

/* Return the kernel of an object that `Library.kernel` returned; NULL for any other object. */
Kernel *kernel_of(PyObject *given);

int add_library(PyObject *module);

/* Read words in the form that `loewner/_native/entries.py` describes; return their number, or -1 with an exception. */
int read_words(const char *text, Word *words, int most);

#endif
