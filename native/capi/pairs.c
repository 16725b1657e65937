/* Pairs of bodies, without a checker: what `loewner/queries.py` does. */

#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
static const int64_t no_rows[1];

/* One side of a query for kernels: some of the bodies of a pack, as a pack of their own. */
typedef struct {
    int64_t words[PACK_WORDS], start[2], step, pose_step;
    Array3 poses;
} View;

/* View the bodies that pairs first .. first + n - 1 take. */
static loewner_status view(const loewner_side *side, size_t first, size_t n, const char *name, View *made)
{
    if (side == NULL || side->bodies == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "%s: expected bodies, found NULL", name);
    int64_t bodies = side->bodies->file->bodies, all = side->body == -1, which = all ? (int64_t)first : side->body;
    size_t last = first + n;
    if (side->body < -1 || side->body >= bodies || (all && (int64_t)last > bodies))
        return fail(LOEWNER_BAD_ARGUMENT, "%s: expected bodies below number %lld, found others", name,
                    (long long)bodies);
    if (side->poses != NULL && side->pose_count != 1 && side->pose_count < last)
        return fail(LOEWNER_BAD_ARGUMENT, "%s: expected one pose or as many as pairs, found %zu", name,
                    side->pose_count);
    Pack pack = side->bodies->file->whole;
    pack.piece_start += which;
    pack.roots += which;
    pack.bodies = all ? (int64_t)n : 1;
    int64_t from = pack.piece_start[0];
    if (!all && pack.roots[0] < 0) { /* without the other bodies' pieces, kernels take shorter ways */
        made->start[0] = 0;
        made->start[1] = pack.pieces = pack.piece_start[1] - from;
        pack.piece_start = made->start;
        pack.table += COLUMNS * from;
        pack.layout += LAYOUT * from;
        pack.hot += HOT * from;
        pack.single += pack.is_single ? HOT * from : 0;
        pack.part_start += pack.has_parts ? PARTS * from : 0;
    }
    write_words(&pack, made->words);
    made->step = all;
    made->pose_step = side->poses != NULL && side->pose_count > 1;
    const double *poses = side->poses == NULL ? identity : side->poses + 16 * (made->pose_step ? first : 0);
    made->poses = (Array3){poses, made->pose_step ? (int64_t)n : 1, 4, 4};
    return LOEWNER_OK;
}

static loewner_status views(const loewner_side *a, const loewner_side *b, size_t first, size_t n, View made[2],
                            int64_t plan[5])
{
    TRY(view(a, first, n, "a", &made[0]));
    TRY(view(b, first, n, "b", &made[1]));
    const int64_t rows[5] = {(int64_t)n, made[0].step, made[0].pose_step, made[1].step, made[1].pose_step};
    memcpy(plan, rows, sizeof rows);
    return LOEWNER_OK;
}

/* Memory of a workspace for pairs; its checker, if it has one, is bound anew at its next use. */
static loewner_status scratch(loewner_workspace *workspace, int64_t size)
{
    if (workspace->size >= (size_t)size)
        return LOEWNER_OK;
    size_t whole = ((size_t)size + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    free(workspace->block);
    workspace->serial = 0;
    workspace->block = aligned_alloc(CACHE_LINE, whole);
    workspace->size = workspace->block == NULL ? 0 : whole;
    return workspace->block == NULL ? no_memory() : LOEWNER_OK;
}

static loewner_status settle(loewner_workspace *workspace, int mode, const loewner_side *a, const loewner_side *b,
                             size_t n, double margin, int8_t *verdicts)
{
    View sides[2];
    int64_t plan[5], tally[CODE_TIERS] = {0}, are_rigid = 0, nothing, count = (int64_t)n;
    if (kernels() == NULL)
        return LOEWNER_NO_KERNELS;
    if (n == 0)
        return LOEWNER_OK;
    TRY(views(a, b, 0, n, sides, plan));
    if (!(margin >= 0 && margin < INFINITY) || verdicts == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "margin, verdicts: expected a number >= 0 and a pointer, found others");
    HOLD(workspace);
    TRY(scratch(workspace, kernels()->settle_memory));
    workspace->serial = 0; /* its memory is written to */
    struct {
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
    } fast = {
        mode,
        margin,
        0,
        count,
        {plan, 5, 1},
        {no_rows, 2, 0},
        (int64_t)sides[0].words,
        sides[0].poses,
        (int64_t)sides[1].words,
        sides[1].poses,
        {verdicts, count},
        {tally, CODE_TIERS},
        workspace->block,
    };
    TRY(call(kernels()->settle_range, &fast, &are_rigid));
    if (!(are_rigid & 1))
        return fail(LOEWNER_BAD_ARGUMENT, "poses: expected rigid motions, found others");
    if (mode != CODE_EXACT || tally[CODE_OPEN] == 0)
        return LOEWNER_OK;
    struct {
        double margin;
        int64_t first, last;
        Array2 plan, rows;
        int64_t a;
        Array3 poses_a;
        int64_t b;
        Array3 poses_b;
        Array1 out;
    } careful = {margin, 0, count, fast.plan, fast.rows, fast.a, fast.poses_a, fast.b, fast.poses_b, fast.out};
    TRY(call(kernels()->settle_open, &careful, &nothing));
    for (size_t k = 0; k < n; k++)
        if (verdicts[k] == CODE_INEXACT)
            verdicts[k] = LOEWNER_AMBIGUOUS;
    return LOEWNER_OK;
}

loewner_status loewner_classify(loewner_workspace *workspace, const loewner_side *a, const loewner_side *b, size_t n,
                                double margin, int8_t *verdicts)
{
    return settle(workspace, CODE_CERTIFY, a, b, n, margin, verdicts);
}

loewner_status loewner_collide(loewner_workspace *workspace, const loewner_side *a, const loewner_side *b, size_t n,
                               double margin, int8_t *verdicts)
{
    return settle(workspace, CODE_EXACT, a, b, n, margin, verdicts);
}

/* -- distances ----------------------------------------------------------------------------------------------------- */

/* Results of `distance_range`: two arrays with the descriptions of their memory. */
typedef struct {
    void *memory;
    Array2 array;
} Given;

loewner_status loewner_measure(loewner_workspace *workspace, const loewner_side *a, const loewner_side *b, size_t n,
                               loewner_distance *distances)
{
    enum { AT_ONCE = 64 };
    const Kernels *known = kernels();
    if (known == NULL)
        return LOEWNER_NO_KERNELS;
    if (n == 0)
        return LOEWNER_OK;
    if (distances == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "distances: expected a pointer, found NULL");
    HOLD(workspace);
    TRY(scratch(workspace, known->distance_memory));
    workspace->serial = 0;
    for (size_t first = 0; first < n; first += AT_ONCE) {
        View sides[2];
        int64_t plan[5], count = (int64_t)(n - first < AT_ONCE ? n - first : AT_ONCE), nothing;
        double numbers[4 * AT_ONCE], vectors[9 * AT_ONCE];
        int8_t status[AT_ONCE];
        TRY(views(a, b, first, (size_t)count, sides, plan));
        for (int side = 0; side < 2; side++)
            TRY(check_poses(sides[side].poses.data, (size_t)sides[side].poses.count, side == 0 ? "a" : "b"));
        struct {
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
        } arguments = {
            1,
            0,
            count,
            {plan, 5, 1},
            {no_rows, 2, 0},
            (int64_t)sides[0].words,
            sides[0].poses,
            (int64_t)sides[1].words,
            sides[1].poses,
            workspace->block,
            {numbers, 4, count},
            {vectors, 3, count, 3},
            {status, count},
        };
        struct {
            Given pieces, values;
        } left;
        TRY(call(known->distance_range, &arguments, &left));
        struct {
            Array2 pieces, values;
            int64_t a;
            Array3 poses_a;
            int64_t b;
            Array3 poses_b;
            Array2 numbers;
            Array3 vectors;
            Array1 status;
        } rest = {
            left.pieces.array, left.values.array, arguments.a,       arguments.poses_a, arguments.b,
            arguments.poses_b, arguments.numbers, arguments.vectors, arguments.status,
        };
        loewner_status outcome = left.pieces.array.rows == 0 ? LOEWNER_OK : call(known->measure_left, &rest, &nothing);
        known->release(left.pieces.memory);
        known->release(left.values.memory);
        TRY(outcome);
        for (int64_t k = 0; k < count; k++) {
            loewner_distance *found = distances + first + (size_t)k;
            *found = (loewner_distance){numbers[k],      numbers[count + k], NAN, {-1, -1}, {NAN, NAN, NAN},
                                        {NAN, NAN, NAN}, {NAN, NAN, NAN}};
            found->bodies[0] = (int32_t)(a->body == -1 ? (int64_t)first + k : a->body);
            found->bodies[1] = (int32_t)(b->body == -1 ? (int64_t)first + k : b->body);
            if (status[k] != 0 || !isfinite(numbers[3 * count + k]))
                continue;
            found->distance = fmax(found->lower, fmin(numbers[3 * count + k], found->upper));
            memcpy(found->witness_a, vectors + 3 * k, 24);
            memcpy(found->witness_b, vectors + 3 * (count + k), 24);
            memcpy(found->normal, vectors + 3 * (2 * count + k), 24);
        }
    }
    return LOEWNER_OK;
}
