/* Python calls the native library through this extension: `Library` opens a library, and `Kernel` calls one of its
   functions. `pairs.c` and `configurations.c` answer common queries, each in a single call from Python. A function of
   the library has the form int32 loewner_NAME(const int64 *arguments, int64 *results). In both arrays, a number takes
   one slot (an int64), and an array takes one slot for its address and one slot for each of its lengths. In `results`,
   each array also has a slot before these slots: the address of a record that describes the array's memory. The
   extension passes this address to loewner_release to free the memory. The extension does not depend on Numba, and the
   library does not depend on Python. */

#include "call.h"
#include "system.h"

#include <string.h>

#define MOST_SLOTS 96
#define PREFIX "loewner_" /* Beginning of the name of every function that the extension calls. */

/* -- types and objects --------------------------------------------------------------------------------------------- */

PyTypeObject *add_type(PyObject *module, PyType_Spec *spec)
{
    PyTypeObject *type = (PyTypeObject *)PyType_FromModuleAndSpec(module, spec, NULL);
    if (type != NULL && PyModule_AddType(module, type) < 0)
        Py_CLEAR(type);
    return type;
}

void *new_object(PyTypeObject *type)
{
    return PyType_GenericAlloc(type, 0);
}

void free_object(PyObject *object)
{
    PyTypeObject *type = Py_TYPE(object);
    PyObject_Free(object);
    Py_DECREF(type);
}

/* -- signatures of kernels ----------------------------------------------------------------------------------------- */

/* Letters that denote arrays in signatures, and the NumPy types of the arrays' elements. */
static const char ARRAYS[] = "FIBUT";
static const int types[] = {NPY_DOUBLE, NPY_INT64, NPY_INT8, NPY_UINT8, NPY_BOOL};

int read_words(const char *text, Word *words, int most)
{
    int count = 0;
    while (*text) {
        if (count == most) {
            PyErr_SetString(PyExc_ValueError, "expected fewer words in a signature");
            return -1;
        }
        Word *word = &words[count++];
        *word = (Word){.constant = *text == 'c'};
        text += word->constant;
        word->kind = *text;
        const char *array = memchr(ARRAYS, word->kind, sizeof ARRAYS - 1);
        if (array == NULL && memchr("ifb", word->kind, 3) == NULL) {
            PyErr_SetString(PyExc_ValueError, "expected a signature as entries.py describes it");
            return -1;
        }
        text++;
        if (array != NULL) {
            word->kind = 'A';
            word->type = types[array - ARRAYS];
            word->axes = *text++ - '0';
        }
        while (*text == ' ')
            text++;
    }
    return count;
}

static int slots_of(const Word *words, int count, int extra)
{
    int slots = 0;
    for (int n = 0; n < count; n++)
        slots += words[n].kind == 'A' ? 1 + extra + words[n].axes : 1;
    return slots;
}

/* -- Kernel -------------------------------------------------------------------------------------------------------- */

static int put_array(Kernel *kernel, int n, PyObject *given, int64_t **slot)
{
    const Word *word = &kernel->argument[n];
    if (PyArray_Check(given)) {
        PyArrayObject *array = (PyArrayObject *)given;
        int flags = word->constant ? NPY_ARRAY_CARRAY_RO : NPY_ARRAY_CARRAY;
        if (PyArray_NDIM(array) == word->axes && PyArray_TYPE(array) == word->type &&
            PyArray_CHKFLAGS(array, flags) && PyArray_ISNOTSWAPPED(array)) {
            *(*slot)++ = (int64_t)PyArray_DATA(array);
            for (int axis = 0; axis < word->axes; axis++)
                *(*slot)++ = PyArray_DIM(array, axis);
            return 0;
        }
    }
    PyErr_Format(PyExc_TypeError, "%U: argument %d: expected a%s array in C order of type %d with %d axes, found %R",
                 kernel->name, n + 1, word->constant ? "n" : " writeable", word->type, word->axes,
                 PyArray_Check(given) ? (PyObject *)PyArray_DESCR((PyArrayObject *)given) : (PyObject *)Py_TYPE(given));
    return -1;
}

static int put_number(char kind, PyObject *given, int64_t *slot)
{
    if (kind == 'f') {
        double number = PyFloat_AsDouble(given);
        memcpy(slot, &number, sizeof number);
        return number == -1.0 && PyErr_Occurred() ? -1 : 0;
    }
    if (kind == 'b') {
        int truth = PyObject_IsTrue(given);
        *slot = truth;
        return truth < 0 ? -1 : 0;
    }
    PyObject *number = PyNumber_Index(given); /* The number may be a NumPy integer. */
    if (number == NULL)
        return -1;
    *slot = PyLong_AsLongLong(number);
    Py_DECREF(number);
    return *slot == -1 && PyErr_Occurred() ? -1 : 0;
}

/* Convert the slots of one result to a Python object. The memory of an array is released even after an error. */
static PyObject *taken(const Kernel *kernel, const Word *word, const int64_t **slot)
{
    if (word->kind == 'A') {
        void *memory = (void *)*(*slot)++, *data = (void *)*(*slot)++;
        npy_intp lengths[4];
        for (int axis = 0; axis < word->axes; axis++)
            lengths[axis] = *(*slot)++;
        PyObject *array = PyErr_Occurred() ? NULL : PyArray_SimpleNew(word->axes, lengths, word->type);
        if (array != NULL)
            memcpy(PyArray_DATA((PyArrayObject *)array), data, PyArray_NBYTES((PyArrayObject *)array));
        kernel->release(memory);
        return array;
    }
    int64_t number = *(*slot)++;
    if (PyErr_Occurred())
        return NULL;
    if (word->kind == 'f') {
        double value;
        memcpy(&value, &number, sizeof value);
        return PyFloat_FromDouble(value);
    }
    return word->kind == 'b' ? PyBool_FromLong(number & 1) : PyLong_FromLongLong(number);
}

static PyObject *kernel_call(Kernel *kernel, PyObject *const *given, Py_ssize_t count)
{
    int64_t arguments[MOST_SLOTS], results[MOST_SLOTS], *slot = arguments;
    if (count != kernel->arguments)
        return PyErr_Format(PyExc_TypeError, "%U: expected %d arguments by position", kernel->name, kernel->arguments);
    for (int n = 0; n < kernel->arguments; n++) {
        char kind = kernel->argument[n].kind;
        if (kind == 'A' ? put_array(kernel, n, given[n], &slot) : put_number(kind, given[n], slot++))
            return NULL;
    }
    int32_t code;
    Py_BEGIN_ALLOW_THREADS
    code = kernel->function(arguments, results);
    Py_END_ALLOW_THREADS
    if (code != 0) /* The only error that a kernel can report is a lack of memory. */
        return PyErr_Format(PyExc_MemoryError, "an allocation failed in %U", kernel->name);
    if (kernel->results == 0)
        Py_RETURN_NONE;
    const int64_t *from = results;
    if (kernel->results == 1)
        return taken(kernel, &kernel->result[0], &from);
    PyObject *tuple = PyTuple_New(kernel->results);
    for (int n = 0; n < kernel->results; n++) {
        PyObject *one = taken(kernel, &kernel->result[n], &from);
        if (tuple == NULL)
            Py_XDECREF(one);
        else
            PyTuple_SetItem(tuple, n, one);
    }
    if (PyErr_Occurred())
        Py_CLEAR(tuple);
    return tuple;
}

static void kernel_free(PyObject *self)
{
    Kernel *kernel = (Kernel *)self;
    Py_XDECREF(kernel->library);
    Py_XDECREF(kernel->name);
    free_object(self);
}

static PyType_Spec kernel_spec = {
    .name = "loewner._native._call.Kernel",
    .basicsize = sizeof(Kernel),
    .flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_DISALLOW_INSTANTIATION,
    .slots = (PyType_Slot[]){{Py_tp_dealloc, kernel_free}, {0, NULL}},
};

static PyTypeObject *KernelType;

Kernel *kernel_of(PyObject *given)
{
    PyObject *self = PyCFunction_Check(given) ? PyCFunction_GetSelf(given) : NULL;
    return self != NULL && Py_TYPE(self) == KernelType ? (Kernel *)self : NULL;
}

/* -- Library ------------------------------------------------------------------------------------------------------- */

typedef struct {
    PyObject_HEAD
    void *handle;
} Library;

static PyObject *library_new(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    PyObject *path;
    const char *build;
    static char *known[] = {"path", "build", NULL};
    if (!PyArg_ParseTupleAndKeywords(arguments, names, "O&s", known, PyUnicode_FSConverter, &path, &build))
        return NULL;
    void *handle = dlopen(PyBytes_AsString(path), RTLD_NOW | RTLD_LOCAL);
    Py_DECREF(path);
    if (handle == NULL)
        return PyErr_Format(PyExc_OSError, "%s", dlerror());
    const char *found = dlsym(handle, "loewner_build");
    if (found == NULL || strcmp(found, build) != 0) {
        PyErr_Format(PyExc_OSError, "expected a library built from %s, found %s", build, found ? found : "another");
        dlclose(handle); /* The library is closed only now, because the message quotes one of its strings. */
        return NULL;
    }
    Library *library = new_object(type);
    if (library == NULL)
        return NULL;
    library->handle = handle; /* The library stays open until the process ends, because threads may be running in it. */
    return (PyObject *)library;
}

static PyObject *library_kernel(PyObject *self, PyObject *arguments)
{
    Library *library = (Library *)self;
    const char *name, *takes, *gives;
    if (!PyArg_ParseTuple(arguments, "sss", &name, &takes, &gives))
        return NULL;
    Kernel *kernel = new_object(KernelType);
    if (kernel == NULL)
        return NULL;
    PyOS_snprintf(kernel->symbol, sizeof kernel->symbol, PREFIX "%s", name);
    kernel->definition = (PyMethodDef)FAST_METHOD(kernel->symbol + strlen(PREFIX), kernel_call, NULL);
    kernel->library = Py_NewRef(self);
    kernel->name = PyUnicode_FromString(name);
    kernel->function = (Function)dlsym(library->handle, kernel->symbol);
    kernel->release = (void (*)(void *))dlsym(library->handle, "loewner_release");
    kernel->arguments = read_words(takes, kernel->argument, MOST_WORDS);
    kernel->results = kernel->arguments < 0 ? -1 : read_words(gives, kernel->result, MOST_WORDS);
    if (kernel->results >= 0 && (kernel->function == NULL || kernel->release == NULL))
        PyErr_Format(PyExc_OSError, "expected a function %s, found none", kernel->symbol);
    else if (kernel->results >= 0 && (slots_of(kernel->argument, kernel->arguments, 0) > MOST_SLOTS ||
                                      slots_of(kernel->result, kernel->results, 1) > MOST_SLOTS))
        PyErr_Format(PyExc_ValueError, "%s: expected fewer arguments", name);
    /* Make a built-in function that holds the kernel, because the interpreter calls built-in functions faster than any
       other object. */
    PyObject *made = PyErr_Occurred() ? NULL : PyCFunction_NewEx(&kernel->definition, (PyObject *)kernel, NULL);
    Py_DECREF(kernel);
    return made;
}

static PyMethodDef library_methods[] = {
    {"kernel", library_kernel, METH_VARARGS, "kernel(name, arguments, results): see `entries.py`."},
    {NULL, NULL, 0, NULL},
};

static PyType_Spec library_spec = {
    .name = "loewner._native._call.Library",
    .basicsize = sizeof(Library),
    .flags = Py_TPFLAGS_DEFAULT,
    .slots = (PyType_Slot[]){
        {Py_tp_doc, "Library(path, build): open a native library that was built from certain sources."},
        {Py_tp_new, library_new},
        {Py_tp_methods, library_methods},
        {0, NULL},
    },
};

int add_library(PyObject *module)
{
    KernelType = add_type(module, &kernel_spec);
    return KernelType != NULL && add_type(module, &library_spec) != NULL ? 0 : -1;
}
