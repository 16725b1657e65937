/* The extension module, and the functions that it offers to Python. */

#define HOLDS_ARRAY_API
#include "single.h"
#include "levels.h"

static PyObject *levels(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(nothing))
{
    const char *const *known = processor_levels();
    Py_ssize_t count = 0;
    while (known[count] != NULL)
        count++;
    PyObject *tuple = PyTuple_New(count);
    for (Py_ssize_t k = 0; tuple != NULL && k < count; k++) {
        PyObject *name = PyUnicode_FromString(known[k]);
        if (name == NULL || PyTuple_SetItem(tuple, k, name) < 0)
            Py_CLEAR(tuple);
    }
    return tuple;
}

static PyMethodDef functions[] = {
    {"levels", levels, METH_NOARGS, "Levels whose code this processor runs, the best first."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_call", .m_doc = "Calls into the native library.", .m_size = -1,
    .m_methods = functions,
};

PyMODINIT_FUNC PyInit__call(void)
{
    import_array();
    PyObject *module = PyModule_Create(&definition);
    if (module == NULL || add_library(module) < 0 || prepare_single() < 0 || add_pairs(module) < 0 ||
        add_configurations(module) < 0)
        Py_CLEAR(module);
    return module;
}
