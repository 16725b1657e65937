/* Queries about pairs of bodies without a checker; the counterpart in Python is `loewner/queries/pairs.py`. */

#include "internal.h"

#include <math.h>

static const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
static const int64_t no_rows[1];

/* One side of a query, in the form that kernels take: some bodies of a pack, presented as a pack of their own. */
typedef struct {
    struct pieces pieces;
    int64_t start[2], step, pose_step;
    Array3 poses;
} View;

/* Return the rows first .. first + count - 1 of an array whose entries have `item` bytes; an array without rows is
   returned unchanged. */
static Array2 some_rows(Array2 array, size_t item, int64_t first, int64_t count)
{
    const char *data = array.data;
    return array.rows == 0 ? array : (Array2){data + (int64_t)item * array.columns * first, count, array.columns};
}

/* Make a view of the bodies of the pairs first .. first + n - 1. */
static loewner_status view(const loewner_side *side, size_t first, size_t n, const char *name, View *made)
{
    REQUIRE(side != NULL && side->bodies != NULL, "%s: expected bodies, found NULL", name);
    TRY(check_count(n, 1, name));
    int64_t bodies = side->bodies->bodies, all = side->body == -1, which = all ? (int64_t)first : side->body;
    size_t last = first + n;
    REQUIRE(side->body >= -1 && side->body < bodies && (!all || (int64_t)last <= bodies),
            "%s: expected bodies below number %lld, found others", name, (long long)bodies);
    REQUIRE(side->poses == NULL || side->pose_count == 1 || side->pose_count >= last,
            "%s: expected one pose or as many as pairs, found %zu", name, side->pose_count);
    struct pieces *pack = &made->pieces;
    *pack = side->bodies->packs[WHOLE];
    pack->piece_start = some_rows(pack->piece_start, 8, which, all ? (int64_t)n + 1 : 2);
    pack->roots = some_rows(pack->roots, 8, which, all ? (int64_t)n : 1);
    const int64_t *start = pack->piece_start.data, *root = pack->roots.data;
    if (!all && *root < 0) { /* Leave out the pieces of other bodies, because kernels are faster without them. */
        int64_t from = start[0], count = start[1] - from;
        made->start[0] = 0;
        made->start[1] = count;
        pack->piece_start.data = made->start;
        pack->table = some_rows(pack->table, 8, from, count);
        pack->layout = some_rows(pack->layout, 8, from, count);
        pack->hot = some_rows(pack->hot, 8, from, count);
        pack->single = some_rows(pack->single, 4, from, count);
        pack->part_start = some_rows(pack->part_start, 8, PARTS * from, PARTS * count);
    }
    made->step = all;
    made->pose_step = side->poses != NULL && side->pose_count > 1;
    const double *poses = side->poses == NULL ? identity : side->poses + 16 * (made->pose_step ? first : 0);
    made->poses = (Array3){poses, made->pose_step ? (int64_t)n : 1, 4, 4};
    return LOEWNER_OK;
}

/* Kernel arguments: the plan for n pairs, which is an array of five integers, and the arguments that describe two
   views. */
#define PLAN(n, a, b) {(n), (a).step, (a).pose_step, (b).step, (b).pose_step}
#define VIEWS(numbers, a, b)                                                                                           \
    .plan = {numbers, 5, 1}, .rows = {no_rows, 2, 0}, .pack_a = (int64_t)&(a).pieces, .Ta = (a).poses,                 \
    .pack_b = (int64_t)&(b).pieces, .Tb = (b).poses

loewner_status settle_all(const struct settle_range *asked, int *are_rigid)
{
    const int64_t *tally = asked->tally.data;
    int8_t *out = (int8_t *)asked->out.data;
    int64_t rigid = 0;
    TRY(call(kernels()->settle_range, asked, &rigid));
    *are_rigid = rigid & 1;
    if (!*are_rigid || asked->mode != CODE_EXACT || tally[CODE_OPEN] == 0)
        return LOEWNER_OK;
    TRY(CALL(settle_open, NULL, .margin = asked->margin, .start = asked->start, .stop = asked->stop,
             .plan = asked->plan, .rows = asked->rows, .pack_a = asked->pack_a, .Ta = asked->Ta,
             .pack_b = asked->pack_b, .Tb = asked->Tb, .out = asked->out));
    for (int64_t k = asked->start; k < asked->stop; k++)
        if (out[k] == CODE_INEXACT) /* Only the Python package decides such a pair, with exact integers. */
            out[k] = LOEWNER_AMBIGUOUS;
    return LOEWNER_OK;
}

static loewner_status settle(loewner_workspace *workspace, int mode, const loewner_side *a, const loewner_side *b,
                             size_t n, double margin, int8_t *verdicts)
{
    View first, second;
    int64_t tally[CODE_TIERS] = {0}, count = (int64_t)n;
    int are_rigid;
    if (kernels() == NULL)
        return LOEWNER_NO_KERNELS;
    if (n == 0)
        return LOEWNER_OK;
    TRY(view(a, 0, n, "a", &first));
    TRY(view(b, 0, n, "b", &second));
    REQUIRE(margin >= 0 && margin < INFINITY && verdicts != NULL,
            "margin, verdicts: expected a number >= 0 and a pointer, found others");
    HOLD(workspace);
    TRY(reserve(workspace, (size_t)kernels()->settle_memory));
    const int64_t plan[5] = PLAN(count, first, second);
    const struct settle_range asked = {
        .mode = mode, .margin = margin, .stop = count, VIEWS(plan, first, second), .out = {verdicts, count},
        .tally = {tally, CODE_TIERS}, .memory = workspace->block,
    };
    TRY(settle_all(&asked, &are_rigid));
    return are_rigid ? LOEWNER_OK : fail(LOEWNER_BAD_ARGUMENT, "poses: expected rigid motions, found others");
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

void write_distance(loewner_distance *found, const double *lower, const double *upper, const double *values,
                    const double *vectors, int64_t n, int64_t k, int is_settled)
{
    double *const places[] = {found->witness_a, found->witness_b, found->normal};
    int is = is_settled && isfinite(values[k]);
    found->lower = lower[k];
    found->upper = upper[k];
    /* The bounds are proven, but the value itself is not. A value outside the bounds is therefore moved to the nearest
       bound. */
    found->distance = is ? fmax(lower[k], fmin(values[k], upper[k])) : NAN;
    for (int vector = 0; vector < 3; vector++)
        for (int c = 0; c < 3; c++)
            places[vector][c] = is ? vectors[3 * (n * vector + k) + c] : NAN;
}

loewner_status loewner_measure(loewner_workspace *workspace, const loewner_side *a, const loewner_side *b, size_t n,
                               loewner_distance *distances)
{
    enum { AT_ONCE = 64 };
    const Kernels *known = kernels();
    if (known == NULL)
        return LOEWNER_NO_KERNELS;
    if (n == 0)
        return LOEWNER_OK;
    TRY(expect_pointer(distances, n, "distances"));
    HOLD(workspace);
    TRY(reserve(workspace, (size_t)known->distance_memory));
    for (size_t first = 0; first < n; first += AT_ONCE) {
        View at_a, at_b;
        int64_t count = (int64_t)at_most(n - first, AT_ONCE);
        double numbers[4 * AT_ONCE], vectors[9 * AT_ONCE];
        int8_t status[AT_ONCE];
        TRY(view(a, first, (size_t)count, "a", &at_a));
        TRY(view(b, first, (size_t)count, "b", &at_b));
        TRY(check_poses(at_a.poses.data, (size_t)at_a.poses.count, "a"));
        TRY(check_poses(at_b.poses.data, (size_t)at_b.poses.count, "b"));
        const int64_t plan[5] = PLAN(count, at_a, at_b);
        const struct distance_range asked = {
            .wanted = 1, .stop = count, VIEWS(plan, at_a, at_b), .memory = workspace->block,
            .numbers = {numbers, 4, count}, .vectors = {vectors, 3, count, 3}, .status = {status, count},
        };
        struct distance_range_results left;
        TRY(call(known->distance_range, &asked, &left));
        loewner_status outcome = LOEWNER_OK;
        if (left.pieces.array.rows > 0)
            outcome = CALL(measure_left, NULL, .pieces = left.pieces.array, .values = left.values.array,
                           .pack_a = asked.pack_a, .Ta = asked.Ta, .pack_b = asked.pack_b, .Tb = asked.Tb,
                           .numbers = asked.numbers, .vectors = asked.vectors, .status = asked.status);
        known->release(left.pieces.memory);
        known->release(left.values.memory);
        TRY(outcome);
        for (int64_t k = 0; k < count; k++) {
            loewner_distance *found = distances + first + (size_t)k;
            write_distance(found, numbers, numbers + count, numbers + 3 * count, vectors, count, k, status[k] == 0);
            found->bodies[0] = (int32_t)(a->body == -1 ? (int64_t)first + k : a->body);
            found->bodies[1] = (int32_t)(b->body == -1 ? (int64_t)first + k : b->body);
        }
    }
    return LOEWNER_OK;
}
