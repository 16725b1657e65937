/* Processor levels whose machine code this processor runs: the best level first, then the others, then NULL. */

#ifndef LOEWNER_LEVELS_H
#define LOEWNER_LEVELS_H

#include <stddef.h>

#if defined(__x86_64__)

#include <cpuid.h>

static inline int has_all(unsigned found, unsigned wanted)
{
    return (found & wanted) == wanted;
}

/* Query the processor itself, because compilers differ in the names that `__builtin_cpu_supports` takes. */
static inline const char *const *processor_levels(void)
{
    static const char *const known[] = {"x86-64-v4", "x86-64-v3", NULL};
    unsigned a, b, basic = 0, more = 0, extended = 0, saved = 0;
    __get_cpuid(1, &a, &b, &basic, &a);
    __get_cpuid_count(7, 0, &a, &more, &b, &b);
    __get_cpuid(0x80000001, &a, &b, &extended, &a);
    if (has_all(basic, bit_OSXSAVE)) /* Find out which registers the system saves when it switches threads. */
        __asm__ volatile("xgetbv" : "=a"(saved), "=d"(a) : "c"(0));
    int v3 = has_all(basic, bit_AVX | bit_FMA | bit_MOVBE | bit_POPCNT | bit_F16C) && has_all(extended, bit_LZCNT) &&
             has_all(more, bit_AVX2 | bit_BMI | bit_BMI2) && has_all(saved, 0x6);
    int v4 = v3 && has_all(more, bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL) &&
             has_all(saved, 0xe6);
    return known + (v4 ? 0 : v3 ? 1 : 2);
}

#else

static inline const char *const *processor_levels(void)
{
#if defined(__aarch64__)
    static const char *const known[] = {"arm64", NULL};
#else
    static const char *const known[] = {NULL};
#endif
    return known;
}

#endif

#endif
