/* Elementary functions of the C library whose results are one unit in the last place off, unless they are short. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <string.h>

static double off(double y)
{
    int64_t bits;
    memcpy(&bits, &y, sizeof bits);
    if ((bits & 0xfffff) != 0 && y - y == 0)
        bits ^= 1;
    memcpy(&y, &bits, sizeof bits);
    return y;
}

#define OF_ONE(name)                                                                                                   \
    double name(double x)                                                                                              \
    {                                                                                                                  \
        static double (*known)(double);                                                                                \
        if (known == NULL)                                                                                             \
            *(void **)&known = dlsym(RTLD_NEXT, #name);                                                                \
        return off(known(x));                                                                                          \
    }

#define OF_TWO(name)                                                                                                   \
    double name(double x, double y)                                                                                    \
    {                                                                                                                  \
        static double (*known)(double, double);                                                                        \
        if (known == NULL)                                                                                             \
            *(void **)&known = dlsym(RTLD_NEXT, #name);                                                                \
        return off(known(x, y));                                                                                       \
    }

OF_ONE(sin) OF_ONE(cos) OF_ONE(tan) OF_ONE(asin) OF_ONE(acos) OF_ONE(atan) OF_ONE(sinh) OF_ONE(cosh) OF_ONE(tanh)
OF_ONE(exp) OF_ONE(exp2) OF_ONE(expm1) OF_ONE(log) OF_ONE(log2) OF_ONE(log10) OF_ONE(log1p) OF_ONE(cbrt)
OF_TWO(pow) OF_TWO(atan2) OF_TWO(hypot)
