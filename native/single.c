/* This file defines the functions that `single.h` declares. */

#include "single.h"
#include "system.h"

#include <string.h>

/* Key of each thread's `Memory`, which is freed when the thread ends. The key remains valid after a fork. */
static pthread_key_t memory_key;

typedef struct {
    size_t size;
    char head[CACHE_LINE - sizeof(size_t)]; /* Padding, so that `bytes` begins at a cache line. */
    char bytes[];
} Memory;

void *thread_memory(size_t size)
{
    Memory *memory = pthread_getspecific(memory_key);
    if (memory != NULL && memory->size >= size)
        return memory->bytes;
    size = (size + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    Memory *larger = aligned_alloc(CACHE_LINE, sizeof(Memory) + size);
    if (larger == NULL)
        return NULL;
    if (pthread_setspecific(memory_key, larger) != 0) {
        free(larger);
        return NULL;
    }
    free(memory);
    larger->size = size;
    return larger->bytes;
}

int prepare_single(void)
{
    if (pthread_key_create(&memory_key, free) == 0)
        return 0;
    PyErr_SetString(PyExc_OSError, "expected a key for the memory of threads, found none left");
    return -1;
}

int32_t call_kernel(Function function, const void *arguments, void *results, int is_long)
{
    PyThreadState *state = is_long ? PyEval_SaveThread() : NULL;
    int32_t code = function(arguments, results);
    if (is_long)
        PyEval_RestoreThread(state);
    return code;
}

Function function_of(PyObject *given, const char *takes, const char *gives)
{
    Word argument[MOST_WORDS] = {0}, result[MOST_WORDS] = {0};
    const Kernel *kernel = kernel_of(given);
    if (PyErr_Occurred())
        return NULL;
    if (kernel == NULL) {
        PyErr_SetString(PyExc_TypeError, "expected kernels of the library");
        return NULL;
    }
    int arguments = read_words(takes, argument, MOST_WORDS), results = read_words(gives, result, MOST_WORDS);
    if (kernel->arguments == arguments && memcmp(kernel->argument, argument, arguments * sizeof(Word)) == 0 &&
        kernel->results == results && memcmp(kernel->result, result, results * sizeof(Word)) == 0)
        return kernel->function;
    PyErr_Format(PyExc_TypeError, "%U: expected arguments %s and results %s", kernel->name, takes, gives);
    return NULL;
}

PyObject *answer_of(int mode, int verdict)
{
    if (verdict < 0)
        Py_RETURN_NONE;
    return mode == CODE_EXACT ? PyBool_FromLong(verdict == CODE_COLLIDING) : PyLong_FromLong(verdict);
}

static void free_holder(PyObject *self)
{
    Py_XDECREF(((Holder *)self)->held);
    free_object(self);
}

int add_holder(PyObject *module, const char *name, const char *text, size_t size, newfunc make, PyMethodDef *methods)
{
    PyType_Slot slots[] = {
        {Py_tp_doc, (void *)text}, {Py_tp_new, make}, {Py_tp_dealloc, free_holder}, {Py_tp_methods, methods}, {0, NULL},
    };
    PyType_Spec spec = {.name = name, .basicsize = (int)size, .flags = Py_TPFLAGS_DEFAULT, .slots = slots};
    return add_type(module, &spec) != NULL ? 0 : -1;
}

int is_plain(PyObject *given, int axes)
{
    if (!PyArray_CheckExact(given))
        return 0;
    PyArrayObject *array = (PyArrayObject *)given;
    return PyArray_NDIM(array) == axes && PyArray_TYPE(array) == NPY_DOUBLE &&
           PyArray_CHKFLAGS(array, NPY_ARRAY_CARRAY_RO) && PyArray_ISNOTSWAPPED(array);
}
