/* These declarations are shared by the queries for single pairs and for single configurations. A query returns None if
   an argument is not of the usual kind, or if the answer takes more than one call of a kernel. After None, Python goes
   the long way, with all checks and errors. The queries themselves raise no errors, so that the text of each error
   exists only once. */

#ifndef LOEWNER_SINGLE_H
#define LOEWNER_SINGLE_H

#include "call.h"
#include "kernels.h"

#include <stddef.h>

/* Return at least `size` bytes to which kernels may write, and which belong to this thread; NULL if they cannot be
   allocated. The next call overwrites these bytes. No Python code runs between the call of a kernel and the last use of
   its results: the handler of a signal waits until the interpreter continues, and no Python object is allocated before
   that. A thread therefore never needs this memory twice at a time. */
void *thread_memory(size_t size);

/* Call a kernel, and let other threads run meanwhile if `is_long`. Return the kernel's code, which is 0 unless memory
   ran out. */
int32_t call_kernel(Function function, const void *arguments, void *results, int is_long);

/* Return whether an object is a kernel with this signature; if not, set an exception. */
int is_kernel(PyObject *given, const char *takes, const char *gives);

/* Return whether an array is exactly of NumPy's class, and holds float64 in the layout that kernels take. */
int is_plain(PyObject *given, int axes);

int prepare_single(void);
int add_pairs(PyObject *module);
int add_configurations(PyObject *module);

#endif
