/* These declarations are shared by the queries for single pairs and for single configurations. A query returns None if
   an argument is not of the usual kind, or if the answer takes more than one call of a kernel. After None, Python goes
   the long way, with all checks and errors. The queries themselves raise no errors, so that the text of each error
   exists only once. */

#ifndef LOEWNER_SINGLE_H
#define LOEWNER_SINGLE_H

#include "call.h"
#include "kernels.h"

#include <stddef.h>

/* Return at least `size` bytes of this thread's memory, to which kernels may write; NULL if they cannot be allocated.
   The next call overwrites these bytes. No Python code runs between the call of a kernel and the last use of its
   results: signal handlers wait until the interpreter continues, and until then no Python object is allocated. A thread
   therefore never needs this memory for two calls at the same time. */
void *thread_memory(size_t size);

/* Call a kernel, and let other threads run in the meantime if `is_long`. Return the kernel's code, which is 0 unless
   memory ran out. */
int32_t call_kernel(Function function, const void *arguments, void *results, int is_long);

/* With more than MANY pairs of pieces, other threads may run during a call; with fewer pairs, letting them run would
   cost too much. */
#define MANY 64

/* Return the function of a kernel with this signature; NULL, with an exception, for any other object. An exception that
   is set already remains. */
Function function_of(PyObject *given, const char *takes, const char *gives);

/* Return the answer of a query: a bool in the mode EXACT, otherwise the number of the verdict; None for -1. */
PyObject *answer_of(int mode, int verdict);

/* The beginning of an object for queries. `held` keeps alive the objects to which the other fields refer. */
typedef struct {
    PyObject_HEAD
    PyObject *held;
} Holder;

/* Make a type for such objects of `size` bytes, and add the type to a module; return 0, or -1 with an exception. */
int add_holder(PyObject *module, const char *name, const char *text, size_t size, newfunc make, PyMethodDef *methods);

/* Return whether an array is exactly of NumPy's class, and holds float64 in the layout that kernels take. */
int is_plain(PyObject *given, int axes);

int prepare_single(void);
int add_pairs(PyObject *module);
int add_configurations(PyObject *module);

#endif
