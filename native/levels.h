/* Levels of processors whose machine code this one runs: the best first, then the others, then NULL. */

#ifndef LOEWNER_LEVELS_H
#define LOEWNER_LEVELS_H

#include <stddef.h>

static inline const char *const *processor_levels(void)
{
    static const char *const none[] = {NULL};
#if defined(__x86_64__)
    static const char *const known[] = {"x86-64-v4", "x86-64-v3", NULL};
    __builtin_cpu_init();
    int v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
             __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt") && __builtin_cpu_supports("f16c") &&
             __builtin_cpu_supports("lzcnt") && __builtin_cpu_supports("movbe");
    int v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
             __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
             __builtin_cpu_supports("avx512vl");
    return v4 ? known : v3 ? known + 1 : none;
#elif defined(__aarch64__)
    static const char *const known[] = {"arm64", NULL};
    return known;
#else
    return none;
#endif
}

#endif
