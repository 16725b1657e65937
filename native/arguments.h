/* Arguments of kernels, slot by slot: structs that `call.c` describes, for the extension and for the library for C.

   The words of the signatures are those of `loewner/_native/entries.py`: the extension compares them when it is given a
   kernel, and `tests/test_capi.py` compares them for the library. */

#ifndef LOEWNER_ARGUMENTS_H
#define LOEWNER_ARGUMENTS_H

#include <stdint.h>

_Static_assert(sizeof(void *) == sizeof(int64_t), "an address takes a slot");

typedef struct {
    const void *data;
    int64_t length;
} Array1;

typedef struct {
    const void *data;
    int64_t rows, columns;
} Array2;

typedef struct {
    const void *data;
    int64_t count, rows, columns;
} Array3;

typedef struct {
    const void *data;
    int64_t count, links, rows, columns;
} Array4;

#define SETTLE_TAKES "i f i i I2 I2 i F3 i F3 B1 I1 i"
typedef struct {
    int64_t mode;
    double margin;
    int64_t first, last;
    Array2 plan, rows;
    int64_t a;
    Array3 poses_a;
    int64_t b;
    Array3 poses_b;
    Array1 out, tally;
    void *memory;
} SettleArguments;

#define OPEN_TAKES "f i i I2 I2 i F3 i F3 B1"
typedef struct {
    double margin;
    int64_t first, last;
    Array2 plan, rows;
    int64_t a;
    Array3 poses_a;
    int64_t b;
    Array3 poses_b;
    Array1 out;
} OpenArguments;

#define DISTANCE_TAKES "b i i I2 I2 i F3 i F3 i F2 F3 B1"
typedef struct {
    int64_t wanted, first, last;
    Array2 plan, rows;
    int64_t a;
    Array3 poses_a;
    int64_t b;
    Array3 poses_b;
    void *memory;
    Array2 numbers;
    Array3 vectors;
    Array1 status;
} DistanceArguments;

typedef struct {
    void *memory; /* its description, to be released */
    Array2 array;
} Given2;

#define DISTANCE_GIVES "I2 F2"
typedef struct {
    Given2 pieces, values;
} DistanceResults;

#define LEFT_TAKES "I2 F2 i F3 i F3 F2 F3 B1"
typedef struct {
    Array2 pieces, values;
    int64_t a;
    Array3 poses_a;
    int64_t b;
    Array3 poses_b;
    Array2 numbers;
    Array3 vectors;
    Array1 status;
} LeftArguments;

#define FAULT_TAKES "F3"
#define FAULT_GIVES "i i f"
typedef struct {
    int64_t row, kind;
    double size;
} FaultResults;

#define CHECK_TAKES "i i i F2 i i B1 B1 I1 i"
typedef struct {
    int64_t mode, first, last;
    Array2 configurations;
    int64_t pack, problem;
    Array1 out, tiers, hits;
    void *memory;
} CheckArguments;

#endif
