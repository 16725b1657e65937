/* The extension: what of its files Python sees. */

#define HOLDS_ARRAY_API
#include "single.h"

#if defined(__x86_64__)
#include <cpuid.h>
#endif

/* -- levels of processors ------------------------------------------------------------------------------------------ */

#if defined(__x86_64__)

/* Ask the processor instead of the compiler's `__builtin_cpu_supports`: compilers differ in the names that it takes. */
static int all(unsigned found, unsigned wanted)
{
    return (found & wanted) == wanted;
}

static PyObject *levels(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(nothing))
{
    unsigned a, b, basic = 0, more = 0, extended = 0, saved = 0;
    __get_cpuid(1, &a, &b, &basic, &a);
    __get_cpuid_count(7, 0, &a, &more, &b, &b);
    __get_cpuid(0x80000001, &a, &b, &extended, &a);
    if (all(basic, bit_OSXSAVE)) /* which registers the system saves when it switches threads */
        __asm__ volatile("xgetbv" : "=a"(saved), "=d"(a) : "c"(0));
    int v3 = all(basic, bit_AVX | bit_FMA | bit_MOVBE | bit_POPCNT | bit_F16C) && all(extended, bit_LZCNT) &&
             all(more, bit_AVX2 | bit_BMI | bit_BMI2) && all(saved, 0x6);
    int v4 = v3 && all(more, bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL) &&
             all(saved, 0xe6);
    if (v4)
        return Py_BuildValue("(ss)", "x86-64-v4", "x86-64-v3");
    return v3 ? Py_BuildValue("(s)", "x86-64-v3") : PyTuple_New(0);
}

#else

static PyObject *levels(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(nothing))
{
#if defined(__aarch64__)
    return Py_BuildValue("(s)", "arm64");
#else
    return PyTuple_New(0);
#endif
}

#endif

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
