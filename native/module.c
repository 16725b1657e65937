/* The extension: what of its files Python sees. */

#define HOLDS_ARRAY_API
#include "single.h"

/* -- levels of processors ------------------------------------------------------------------------------------------ */

static PyObject *levels(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(nothing))
{
#if defined(__x86_64__)
    __builtin_cpu_init();
    int v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
             __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt") && __builtin_cpu_supports("f16c") &&
             __builtin_cpu_supports("lzcnt") && __builtin_cpu_supports("movbe");
    int v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
             __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
             __builtin_cpu_supports("avx512vl");
    return v4 ? Py_BuildValue("(ss)", "x86-64-v4", "x86-64-v3") : v3 ? Py_BuildValue("(s)", "x86-64-v3") : PyTuple_New(0);
#elif defined(__aarch64__)
    return Py_BuildValue("(s)", "arm64");
#else
    return PyTuple_New(0);
#endif
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
    if (module == NULL || PyModule_AddType(module, &KernelType) < 0 || PyModule_AddType(module, &LibraryType) < 0 ||
        prepare_single() < 0 || add_pairs(module) < 0 || add_configurations(module) < 0)
        Py_CLEAR(module);
    return module;
}
