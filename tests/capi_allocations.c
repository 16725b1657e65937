/* Count the allocations of a program's proofs after the first one: FILE STEPS FROM TO, where FROM and TO are files of
   configurations, shape (n, dof). Prints the allocations, and how many motions are free. */

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
    printf("%ld %ld\n", after - before, free_count);
    loewner_workspace_free(workspace);
    loewner_checker_close(checker);
    return opened > 0 ? 0 : 3;
}
