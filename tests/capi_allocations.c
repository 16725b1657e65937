/* Count the allocations of a program's proofs after the first one, and of the checks of gates: FILE STEPS FROM TO, where
   FROM and TO are files of configurations, shape (n, dof). Prints the allocations, and how many motions are free. */

#include <loewner.h>
#include <stdio.h>
#include <stdlib.h>

static long count; /* the definitions below replace those of the C library in the whole process */

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t),
    *__libc_memalign(size_t, size_t);

void *malloc(size_t size)
{
    count++;
    return __libc_malloc(size);
}

void *calloc(size_t n, size_t size)
{
    count++;
    return __libc_calloc(n, size);
}

void *realloc(void *old, size_t size)
{
    count++;
    return __libc_realloc(old, size);
}

void *aligned_alloc(size_t to, size_t size)
{
    count++;
    return __libc_memalign(to, size);
}

static void expect(loewner_status status)
{
    if (status != LOEWNER_OK) {
        fprintf(stderr, "%s\n", loewner_error_text());
        exit(1);
    }
}

/* Allocations of checks of chunks from a to b, which begin anew, go on, and are not within the limits. */
static long of_gate(const loewner_checker *checker, const double *a, const double *b, size_t n, int32_t brake,
                    int64_t steps)
{
    enum { TARGETS = 12 };
    size_t dof = (size_t)loewner_checker_dof(checker);
    double *limits = malloc(dof * sizeof(double)), *rows = calloc((TARGETS + 1) * dof, sizeof(double));
    loewner_gate *gate;
    loewner_gate_answer answer;
    for (size_t c = 0; c < dof; c++)
        limits[c] = 5.0;
    const loewner_gate_options options = {.brake = brake, .acceleration = limits, .jerk = brake ? NULL : limits,
                                          .velocity_error = limits, .steps = steps};
    expect(loewner_gate_new(checker, &options, TARGETS, &gate));
    long before = count;
    for (size_t k = 0; k < n * dof; k += dof)
        for (size_t tick = 0; tick < 4; tick++) {
            for (size_t j = 0; j <= TARGETS; j++)
                for (size_t c = 0; c < dof; c++)
                    rows[j * dof + c] = a[k + c] + (double)(tick + j) / 20 * (b[k + c] - a[k + c]);
            expect(loewner_gate_check(gate, rows, rows + dof, rows + dof, TARGETS, 0.02, 0.0, &answer));
        }
    long made = count - before;
    loewner_gate_free(gate);
    free(limits);
    free(rows);
    return made;
}

int main(int argc, char **argv)
{
    loewner_checker *checker;
    loewner_workspace *workspace;
    if (argc != 5)
        return 2;
    expect(loewner_checker_open(argv[1], &checker));
    expect(loewner_workspace_new(&workspace));
    long opened = count; /* some, or the library's allocations are not counted */
    size_t dof = (size_t)loewner_checker_dof(checker), room = 1000, n;
    double *ends[2] = {malloc(room * dof * sizeof(double)), malloc(room * dof * sizeof(double))};
    for (int k = 0; k < 2; k++) {
        FILE *file = fopen(argv[3 + k], "rb");
        n = fread(ends[k], dof * sizeof(double), room, file);
        fclose(file);
    }
    int8_t *verdicts = malloc(room), *free_ones = malloc(room);
    int64_t *taken = malloc(room * sizeof(int64_t));
    const loewner_proof_options options = {.steps = atol(argv[2]), .steps_taken = taken};
    expect(loewner_checker_certify_edges(checker, workspace, ends[0], ends[1], 1, &options, verdicts, NULL, NULL));
    long before = count, free_count = 0;
    for (size_t k = 0; k < n; k++) {
        const double *a = ends[0] + k * dof, *b = ends[1] + k * dof;
        expect(loewner_checker_certify_edges(checker, workspace, a, b, 1, &options, verdicts + k, NULL, NULL));
        expect(loewner_checker_motions_free(checker, workspace, a, b, 1, &options, free_ones + k));
        free_count += verdicts[k] == LOEWNER_FREE;
    }
    expect(loewner_checker_certify_edges(checker, workspace, ends[0], ends[1], n, &options, verdicts, NULL, NULL));
    long after = count;
    long of_gates = of_gate(checker, ends[0], ends[1], n, LOEWNER_BRAKE_JOINTS, options.steps) +
                    of_gate(checker, ends[0], ends[1], n, LOEWNER_BRAKE_PATH, options.steps);
    printf("%ld %ld\n", after - before + of_gates, free_count);
    loewner_workspace_free(workspace);
    loewner_checker_close(checker);
    return opened > 0 ? 0 : 3;
}
