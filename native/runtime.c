/* The only part of Numba's runtime library that kernels need: memory with reference counts. A `Description` has the
   same layout as Numba's MemInfo (numba/core/runtime/nrt.cpp). Compiled code updates the reference count itself, and
   calls NRT_MemInfo_call_dtor when the reference count reaches zero. `tests/test_native.py` compares the layout with
   the layout in the installed version of Numba. */

#include "system.h"

#include <stddef.h>

typedef struct {
    size_t references;
    void (*destructor)(void *, size_t, void *);
    void *destructor_information, *data;
    size_t size;
    void *allocator;
} Description;

EXPORTED const char loewner_build[] = LOEWNER_BUILD;

/* Number of descriptions that have been allocated but not yet freed. The number is zero while no call of a kernel is in
   progress; `tests/test_native.py` checks that calls leave it unchanged. */
EXPORTED size_t loewner_held;

static void give_back(Description *description)
{
    __atomic_sub_fetch(&loewner_held, 1, __ATOMIC_RELAXED);
    free(description);
}

void *NRT_MemInfo_alloc_aligned(size_t size, unsigned alignment)
{
    size_t step = alignment < 64 ? 64 : alignment;
    size_t head = (sizeof(Description) + step - 1) / step * step;
    if (size > (size_t)-1 - head - step)
        return NULL;
    void *memory = aligned_alloc(step, (head + size + step - 1) / step * step);
    if (memory == NULL)
        return NULL;
    __atomic_add_fetch(&loewner_held, 1, __ATOMIC_RELAXED);
    Description *made = memory;
    *made = (Description){.references = 1, .data = (char *)memory + head, .size = size};
    return made;
}

void NRT_MemInfo_call_dtor(void *memory)
{
    give_back(memory); /* No destructor is called, because kernels create no arrays that have one. */
}

/* Release the memory of an array after Python has received and copied the array. */
EXPORTED void loewner_release(void *memory)
{
    Description *description = memory;
    if (description != NULL && __atomic_sub_fetch(&description->references, 1, __ATOMIC_ACQ_REL) == 0)
        give_back(description);
}
