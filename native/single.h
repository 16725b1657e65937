/* What the queries of single pairs and single configurations share.

   A query answers, or returns None: an argument is not of the usual kind, or the answer takes more than one call of a
   kernel. Python then goes the long way, with all its checks, and raises what there is to raise. Nothing is raised by the
   queries, so that no error has two texts. */

#ifndef LOEWNER_SINGLE_H
#define LOEWNER_SINGLE_H

#include "call.h"
#include "kernels.h"

#include <stddef.h>

/* At least `size` bytes for kernels to write to, which belong to this thread; NULL if there are none.

   The next call overwrites them. No Python code runs between the call of a kernel and the last look at what it wrote: a
   signal's handler waits until the interpreter goes on, and nothing of Python's is allocated until then. So nobody asks
   twice at a time. */
void *thread_memory(size_t size);

/* Call a kernel, and let other threads run meanwhile if that takes long; its code, 0 unless memory ran out. */
int32_t call_kernel(Function function, const void *arguments, void *results, int is_long);

/* Tell whether an object is a kernel that takes and gives these words; an exception says that it is not. */
int is_kernel(PyObject *given, const char *takes, const char *gives);

/* Whether an array is exactly of NumPy's class and holds float64 as kernels take them. */
int is_plain(PyObject *given, int axes);

int prepare_single(void);
int add_pairs(PyObject *module);
int add_configurations(PyObject *module);

#endif
