/* Queries about configurations and motions of a checker; the counterparts in Python are
   `loewner/robots/checking/verdicts.py`, `proofs.py` and `distances.py`. */

#include "internal.h"

#include <math.h>
#include <string.h>

_Static_assert(CODE_FREE == LOEWNER_FREE && CODE_COLLIDING == LOEWNER_COLLIDING && CODE_AMBIGUOUS == LOEWNER_AMBIGUOUS,
               "verdicts have the numbers of codes.py");

/* Arguments that pass the scene of a workspace (SCENE) or the tables for motions (MOTIONS) to kernels. */
#define SCENE(workspace)                                                                                               \
    .pack = (workspace)->pack, .problem_handle = (int64_t)&(workspace)->tables, .memory = (workspace)->memory
#define MOTIONS(half)                                                                                                  \
    .pack = (int64_t)&(half)->pieces, .problem_handle = (half)->handle, .tables_handle = (half)->motions

/* -- arguments ----------------------------------------------------------------------------------------------------- */

loewner_status expect_pointer(const void *pointer, size_t n, const char *name)
{
    return pointer != NULL || n == 0 ? LOEWNER_OK
                                     : fail(LOEWNER_BAD_ARGUMENT, "%s: expected a pointer, found NULL", name);
}

loewner_status check_count(size_t n, size_t doubles, const char *name)
{
    /* No address space has room for an array of more than `most` items. */
    const size_t most = ((size_t)1 << 56) / sizeof(double) / doubles;
    REQUIRE(n <= most, "%s: expected at most %zu, found %zu", name, most, n);
    return LOEWNER_OK;
}

loewner_status check_poses(const double *poses, size_t n, const char *name)
{
    struct first_fault_results fault = {0};
    TRY(check_count(n, 16, name));
    REQUIRE(poses != NULL || n == 0, "%s: expected poses, found NULL", name);
    TRY(CALL(first_fault, &fault, .Ts = {poses, (int64_t)n, 4, 4}));
    static const char *const faults[] = {
        "rigid",        "not finite", "with another last row than 0 0 0 1", "whose rotation is not orthonormal",
        "a reflection",
    };
    REQUIRE(fault.k >= (int64_t)n, "%s[%lld]: expected a rigid motion, found one %s", name, (long long)fault.k,
            faults[fault.kind >= 0 && fault.kind <= 4 ? fault.kind : 0]);
    return LOEWNER_OK;
}

loewner_status check_configurations(const loewner_checker *checker, const double *configurations, size_t n,
                                    const char *name)
{
    const File *file = checker->file;
    size_t dof = (size_t)file->dof;
    TRY(check_count(n, dof, name));
    REQUIRE(configurations != NULL || n == 0, "%s: expected configurations, found NULL", name);
    for (size_t k = 0; k < n * dof; k++)
        /* The comparison is false for NaN, so NaN is refused, too. */
        REQUIRE(fabs(configurations[k]) <= LARGEST_VALUE,
                "%s[%zu]: expected finite numbers within %g, found %g for %.100s", name, k / dof, LARGEST_VALUE,
                configurations[k], loewner_checker_value_name(checker, (int32_t)(k % dof)));
    for (int64_t c = 0; c < file->quaternion_count; c++)
        for (size_t k = 0; k < n; k++) {
            const double *q = configurations + k * dof + file->quaternions[c];
            double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
            REQUIRE(fabs(norm - 1) <= QUATERNION_TOLERANCE, "%s: expected quaternions of norm 1, found norm %.9g",
                    name, norm);
        }
    return LOEWNER_OK;
}

/* -- verdicts ------------------------------------------------------------------------------------------------------ */

/* Compute the poses of all links, including the links of attached bodies, at valid configurations. */
static loewner_status place_links(const Tree *tree, const double *configurations, int64_t n, int64_t dof, double *poses)
{
    int64_t links = tree->links;
    return CALL(link_poses, NULL, .parent = {tree->parent, links}, .kind = {tree->kind, links},
                .column = {tree->column, links}, .multiplier = {tree->multiplier, links},
                .offset = {tree->offset, links}, .constants = {tree->constants, links, LINK_CONSTANTS},
                .Q = {configurations, n, dof}, .stop = n, .out = {poses, n, links, 4, 4});
}

/* Compute exact verdicts for all pairs, with the links at the poses that the workspace holds. */
static loewner_status settle_pairs(loewner_workspace *workspace, int8_t *verdicts)
{
    const State *state = &workspace->checker->state;
    int64_t bodies = state->moving + state->standing, count = state->pairs, plan[5] = {count, 1, 1, 1, 1};
    int64_t pack = (int64_t)&state->halves[WHOLE].pieces;
    const Array3 poses = {workspace->poses, bodies, 4, 4};
    for (int64_t k = 0; k < state->moving; k++)
        memcpy(workspace->poses + 16 * k, workspace->link_poses + 16 * state->link[k], 16 * sizeof(double));
    memcpy(workspace->poses + 16 * state->moving, state->poses, (size_t)state->standing * 16 * sizeof(double));
    memset(verdicts, LOEWNER_AMBIGUOUS, (size_t)count);
    for (int64_t first = 0, last; first < count; first = last) {
        for (last = first + 1; last < count && state->margins[last] == state->margins[first];)
            last++;
        int64_t tally[CODE_TIERS] = {0};
        int are_rigid;
        const struct settle_range asked = {
            .mode = CODE_EXACT, .margin = state->margins[first], .start = first, .stop = last, .plan = {plan, 5, 1},
            .rows = {state->rows, 2, count}, .pack_a = pack, .Ta = poses, .pack_b = pack, .Tb = poses,
            .out = {verdicts, count}, .tally = {tally, CODE_TIERS}, .memory = workspace->memory,
        };
        TRY(settle_all(&asked, &are_rigid));
        if (!are_rigid) /* An overflow has distorted a pose. */
            memset(verdicts + first, LOEWNER_AMBIGUOUS, (size_t)(last - first));
    }
    return LOEWNER_OK;
}

static int8_t worst(const int8_t *verdicts, int64_t count)
{
    if (memchr(verdicts, LOEWNER_COLLIDING, (size_t)count) != NULL)
        return LOEWNER_COLLIDING;
    return memchr(verdicts, LOEWNER_AMBIGUOUS, (size_t)count) != NULL ? LOEWNER_AMBIGUOUS : LOEWNER_FREE;
}

static loewner_status settle_one(loewner_workspace *workspace, const double *q, int8_t *verdicts)
{
    const loewner_checker *checker = workspace->checker;
    TRY(place_links(&checker->state.tree, q, 1, checker->file->dof, workspace->link_poses));
    return settle_pairs(workspace, verdicts);
}

loewner_status worst_pair(loewner_workspace *workspace, const double *q, int8_t *verdict, int64_t *pair)
{
    const int8_t *verdicts = workspace->pair_verdicts;
    int64_t count = workspace->checker->state.pairs;
    TRY(settle_one(workspace, q, workspace->pair_verdicts));
    *verdict = worst(verdicts, count);
    *pair = *verdict == LOEWNER_FREE ? -1 : (const int8_t *)memchr(verdicts, *verdict, (size_t)count) - verdicts;
    return LOEWNER_OK;
}

/* Move the pairs that have collided most often to the front. */
static void learn(loewner_workspace *workspace, int64_t n)
{
    int64_t pairs = workspace->checker->state.pairs;
    workspace->seen += n;
    if (workspace->seen < workspace->next_look)
        return;
    workspace->next_look = 2 * workspace->seen;
    /* A stable insertion sort suffices, because few pairs ever collide, and these pairs soon move to the front. */
    for (int64_t k = 0; k < pairs; k++)
        workspace->order[k] = k;
    for (int64_t k = 1; k < pairs; k++) {
        int64_t pair = workspace->order[k], at = k;
        if (workspace->hits[pair] == 0)
            continue;
        while (at > 0 && workspace->hits[workspace->order[at - 1]] < workspace->hits[pair])
            at--;
        memmove(workspace->order + at + 1, workspace->order + at, (size_t)(k - at) * 8);
        workspace->order[at] = pair;
    }
}

loewner_status collide(loewner_workspace *workspace, int mode, const double *configurations, size_t n, int8_t *verdicts)
{
    int64_t dof = workspace->checker->file->dof, pairs = workspace->checker->state.pairs;
    for (size_t first = 0; first < n; first += CHUNK) {
        int64_t count = (int64_t)at_most(n - first, CHUNK);
        const double *rows = configurations + first * (size_t)dof;
        int8_t *out = verdicts + first;
        TRY(CALL(check_configurations, NULL, .mode = mode == HASTY ? CODE_EXACT : mode, .stop = count,
                 .Q = {rows, count, dof}, .out = {out, count}, .tiers_out = {workspace->tiers, count},
                 .hits = {workspace->hits, pairs}, SCENE(workspace)));
        for (int64_t k = 0; mode == CODE_EXACT && k < count; k++)
            if (out[k] == LOEWNER_AMBIGUOUS) {
                TRY(settle_one(workspace, rows + k * dof, workspace->pair_verdicts));
                out[k] = worst(workspace->pair_verdicts, pairs);
            }
        learn(workspace, count);
    }
    return LOEWNER_OK;
}

static loewner_status asked(const loewner_checker *checker, loewner_workspace *workspace, int mode,
                            const double *configurations, size_t n, int8_t *verdicts)
{
    HOLD_PREPARED(checker, workspace, prepare_exact);
    TRY(check_configurations(checker, configurations, n, "configurations"));
    TRY(expect_pointer(verdicts, n, "verdicts"));
    return collide(workspace, mode, configurations, n, verdicts);
}

loewner_status loewner_checker_classify(const loewner_checker *checker, loewner_workspace *workspace,
                                        const double *configurations, size_t n, int8_t *verdicts)
{
    return asked(checker, workspace, CODE_CERTIFY, configurations, n, verdicts);
}

loewner_status loewner_checker_collide(const loewner_checker *checker, loewner_workspace *workspace,
                                       const double *configurations, size_t n, int8_t *verdicts)
{
    return asked(checker, workspace, CODE_EXACT, configurations, n, verdicts);
}

loewner_status loewner_checker_collide_by_pair(const loewner_checker *checker, loewner_workspace *workspace,
                                               const double *configuration, int8_t *verdicts)
{
    HOLD_PREPARED(checker, workspace, prepare_exact);
    TRY(check_configurations(checker, configuration, 1, "configuration"));
    TRY(expect_pointer(verdicts, 1, "verdicts"));
    return settle_one(workspace, configuration, verdicts);
}

/* Write the product of two poses. */
static void multiply(const double *a, const double *b, double *made)
{
    for (int r = 0; r < 4; r++)
        for (int c = 0; c < 4; c++) {
            made[4 * r + c] = 0;
            for (int m = 0; m < 4; m++)
                made[4 * r + c] += a[4 * r + m] * b[4 * m + c];
        }
}

loewner_status loewner_checker_collide_placed(const loewner_checker *checker, loewner_workspace *workspace,
                                              const double *link_poses, int8_t *verdict, int8_t *verdicts)
{
    HOLD_PREPARED(checker, workspace, prepare_exact);
    const State *state = &checker->state;
    int64_t links = checker->file->links;
    TRY(check_poses(link_poses, (size_t)links, "link_poses"));
    TRY(expect_pointer(verdict, 1, "verdict"));
    memcpy(workspace->link_poses, link_poses, (size_t)links * 16 * sizeof(double));
    /* Attached bodies have their own links, which follow the links of the robot. */
    for (int64_t k = 0; k < state->moving; k++) {
        const Body *body = checker->bodies + state->body[k];
        if (body->is_attached)
            multiply(link_poses + 16 * body->link, body->pose, workspace->link_poses + 16 * state->link[k]);
    }
    int8_t *out = verdicts != NULL ? verdicts : workspace->pair_verdicts;
    TRY(settle_pairs(workspace, out));
    *verdict = worst(out, state->pairs);
    return LOEWNER_OK;
}

loewner_status loewner_checker_link_poses(const loewner_checker *checker, const double *configurations, size_t n,
                                          double *poses)
{
    REQUIRE(checker != NULL && (n == 0 || poses != NULL), "checker, poses: expected pointers, found NULL");
    TRY(check_configurations(checker, configurations, n, "configurations"));
    return place_links(&checker->file->tree, configurations, (int64_t)n, checker->file->dof, poses);
}

/* -- distances ----------------------------------------------------------------------------------------------------- */

/* Return the index of the body to which a piece belongs. */
static int64_t owner(const struct pieces *pieces, int64_t piece)
{
    const int64_t *start = pieces->piece_start.data;
    int64_t body = 0;
    while (start[body + 1] <= piece)
        body++;
    return body;
}

loewner_status loewner_checker_distance(const loewner_checker *checker, loewner_workspace *workspace,
                                        const double *configurations, size_t n, loewner_distance *distances,
                                        double *gradients)
{
    HOLD_PREPARED(checker, workspace, prepare_exact);
    TRY(check_configurations(checker, configurations, n, "configurations"));
    const State *state = &checker->state;
    int64_t dof = checker->file->dof;
    REQUIRE(state->pairs != 0 && (distances != NULL || n == 0),
            "expected pairs to check and a place for distances, found none");
    for (size_t first = 0; first < n; first += MOTIONS_AT_ONCE) {
        int64_t count = (int64_t)at_most(n - first, MOTIONS_AT_ONCE);
        const double *rows = configurations + first * (size_t)dof;
        int8_t *status = workspace->found;
        double *numbers = workspace->numbers, *vectors = workspace->vectors;
        TRY(CALL(nearest_pairs, NULL, .wanted = 1, .stop = count, .Q = {rows, count, dof},
                 .numbers = {numbers, 3, count}, .vectors = {vectors, 3, count, 3},
                 .pieces_out = {workspace->pieces, count, 2}, .status = {status, count}, SCENE(workspace)));
        for (int64_t k = 0; k < count; k++) {
            loewner_distance *found = distances + first + k;
            write_distance(found, numbers, numbers + count, numbers + 2 * count, vectors, count, k, status[k] == 0);
            for (int side = 0; side < 2; side++) {
                int64_t *piece = workspace->pieces + 2 * k + side;
                *piece = status[k] == 0 ? owner(&state->halves[WHOLE].pieces, *piece) : state->pair_list[side];
                found->bodies[side] = state->body[*piece];
            }
        }
        if (gradients == NULL)
            continue;
        double *slopes = gradients + first * (size_t)dof;
        TRY(CALL(pair_gradients, NULL, .stop = count, .Q = {rows, count, dof}, .bodies = {workspace->pieces, count, 2},
                 .force = {vectors + 6 * count, count, 3}, .point = {vectors, count, 3},
                 .slopes = {slopes, count, dof}, SCENE(workspace)));
        for (int64_t k = 0; k < count * dof; k++)
            if (status[k / dof] != 0)
                slopes[k] = NAN;
    }
    return LOEWNER_OK;
}

loewner_status loewner_checker_clearance(const loewner_checker *checker, loewner_workspace *workspace,
                                         const double *configurations, size_t n, double softness, double *clearances,
                                         double *gradients)
{
    HOLD_PREPARED(checker, workspace, prepare_exact);
    TRY(check_configurations(checker, configurations, n, "configurations"));
    const State *state = &checker->state;
    REQUIRE(state->pairs != 0 && (clearances != NULL || n == 0),
            "expected pairs to check and a place for clearances, found none");
    REQUIRE(softness > 0 && softness < INFINITY, "softness: expected a positive number, found %g", softness);
    const Half *half = half_of(checker, OPEN_CUT);
    int64_t dof = checker->file->dof, count = (int64_t)n;
    TRY(CALL(clearances, NULL, .gradient = gradients != NULL, .softness = softness, .stop = count,
             .Q = {configurations, count, dof}, .pack = (int64_t)&half->pieces, .problem_handle = half->handle,
             .memory = workspace->memory, .lower = {clearances, count},
             .slopes = {gradients, gradients != NULL ? count : 0, dof}));
    for (size_t k = 0; k < n; k++)
        if (!isfinite(clearances[k]))
            return fail(LOEWNER_OVERFLOW, "positions overflow at configuration %zu", k);
    return LOEWNER_OK;
}

/* -- motions ------------------------------------------------------------------------------------------------------- */

/* Write to `course`, shape (2, dof), the control points of the straight motion from a to b. */
static void straight(const File *file, const double *a, const double *b, double *course)
{
    size_t size = sizeof(double) * (size_t)file->dof;
    memcpy(course, a, size);
    memcpy(course + file->dof, b, size);
    for (int64_t c = 0; c < file->quaternion_count; c++) { /* Take q or -q, depending on which is nearer to p. */
        const double *p = a + file->quaternions[c];
        double *q = course + file->dof + file->quaternions[c];
        if (p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3] < 0)
            for (int k = 0; k < 4; k++)
                q[k] = -q[k];
    }
}

/* Return the value of an elementary function, with the same bits as in Python. */
static double elementary(int64_t function, double x)
{
    double result = NAN;
    CALL(elementary, NULL, .function = function, .x = {&x, 1}, .y = {&x, 1}, .result = {&result, 1});
    return result;
}

static void normalize(double *quaternion)
{
    double norm = 0;
    for (int k = 0; k < 4; k++)
        norm += quaternion[k] * quaternion[k];
    for (int k = 0; k < 4; k++)
        quaternion[k] /= sqrt(norm);
}

/* Write the orientation at the fraction t of the shorter arc from p to q, as `Robot.between` does. */
static void slerp(const double *p, const double *q, double t, double *made)
{
    double cosine = fmin(p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3], 1.0);
    double angle = elementary(CODE_ARC_COSINE, cosine), of_p = 1 - t, of_q = t;
    if (angle >= 1e-6) {
        double sine = fmax(elementary(CODE_SINE_OF, angle), 1e-12);
        of_p = elementary(CODE_SINE_OF, (1 - t) * angle) / sine;
        of_q = elementary(CODE_SINE_OF, t * angle) / sine;
    }
    for (int k = 0; k < 4; k++)
        made[k] = of_p * p[k] + of_q * q[k];
    normalize(made);
}

/* Compute a power by multiplications only, in the same order as `_matrices.power`, because the last bit of the result
   of `pow` depends on the C library. */
static double power(double x, int32_t exponent)
{
    double raised = 1;
    for (int32_t k = 0; k < exponent; k++)
        raised *= x;
    return raised;
}

void evaluate(const File *file, const double *course, int32_t degree, double t, double *q)
{
    int64_t dof = file->dof;
    if (degree == 1) {
        for (int64_t k = 0; k < dof; k++)
            q[k] = t == 1 ? course[dof + k] : course[k] + t * (course[dof + k] - course[k]);
        for (int64_t c = 0; c < file->quaternion_count; c++)
            slerp(course + file->quaternions[c], course + dof + file->quaternions[c], t, q + file->quaternions[c]);
        return;
    }
    memset(q, 0, (size_t)dof * sizeof *q);
    double choices = 1;
    for (int32_t k = 0; k <= degree; k++) {
        double weight = choices * power(t, k) * power(1 - t, degree - k);
        for (int64_t c = 0; c < dof; c++)
            q[c] += weight * course[dof * k + c];
        choices = choices * (degree - k) / (k + 1);
    }
    for (int64_t c = 0; c < file->quaternion_count; c++)
        normalize(q + file->quaternions[c]);
}

loewner_status certify(loewner_workspace *workspace, const double *courses, int64_t count, int64_t points,
                       int64_t width, double tolerance, int8_t as_given, int64_t steps, int8_t *verdicts)
{
    const Half *half = half_of(workspace->checker, CUT);
    int64_t dof = workspace->checker->file->dof;
    memset(verdicts, as_given, (size_t)count);
    for (int64_t k = 0; k < count; k++)
        workspace->work[WORK * k + WORK - 1] = steps;
    /* The argument `clear` is omitted, because pairs need not keep a larger distance than their margins. */
    return CALL(certify_motions, NULL, .stop = count, .courses = {courses, count, points, dof},
                .off = {workspace->off, width > 0 ? count : 0, width}, .tolerance = tolerance, MOTIONS(half),
                .out = {verdicts, count}, .t_out = {workspace->fractions, count},
                .pair_out = {workspace->found_pairs, count}, .tallies = {workspace->work, count, WORK},
                .memory = workspace->memory);
}

/* Bound how far the points of a body may be from the places that the checker assumes, at a time t that may be off by
   `late` [s]. The bound includes more than enough room for rounding (B69). */
static double off_at(const loewner_checker *checker, int64_t place, double t, double late)
{
    const struct pieces *pieces = &checker->state.halves[WHOLE].pieces;
    const int64_t *start = pieces->piece_start.data;
    const double *table = pieces->table.data;
    const loewner_bounds *bounds = &checker->bodies[checker->state.body[place]].bounds;
    double reach = 0, off;
    for (int64_t p = start[place]; p < start[place + 1]; p++)
        reach = fmax(reach, STRETCH * table[COLUMNS * p + REACH]);
    off = bounds->metres + reach * bounds->radians;
    if (bounds->speed > 0 || bounds->turn > 0)
        off += (bounds->speed + reach * bounds->turn) * (fabs(t - bounds->since) + late);
    return fmin(off * (1 + 0x1p-44), 1e100); /* The result is also 1e100 for NaN. */
}

void write_off(const loewner_checker *checker, const double *course, int64_t points, const double *joint_error,
               double t0, double t1, double late, double *row)
{
    const State *state = &checker->state;
    int64_t dof = checker->file->dof;
    for (int64_t c = 0; c < dof; c++) {
        double most = 0;
        for (int64_t p = 0; p < points; p++)
            most = fmax(most, fabs(course[p * dof + c]));
        *row++ = joint_error != NULL ? joint_error[c] + ROUNDED_VALUES * most : 0;
    }
    for (int64_t place = state->moving; place < state->moving + state->standing; place++) {
        if (!checker->bodies[state->body[place]].has_bounds)
            continue;
        double start = off_at(checker, place, t0, late), end = off_at(checker, place, t1, late);
        double more = 0x1p-44 * fmax(start, end);
        row[0] = (double)place;
        row[1] = start + more;
        row[2] = end + more;
        row += 3;
    }
}

/* Write how many steps each motion took; `first` is the index of the first motion. */
static void write_steps(const loewner_workspace *workspace, const loewner_proof_options *options, size_t first,
                        size_t count)
{
    for (size_t k = 0; options->steps_taken != NULL && k < count; k++)
        options->steps_taken[first + k] = workspace->work[WORK * k + WORK - 1];
}

loewner_status prove(loewner_workspace *workspace, size_t first, size_t n, int32_t degree,
                     const loewner_proof_options *options, int8_t *verdicts)
{
    const loewner_checker *checker = workspace->checker;
    const State *state = &checker->state;
    const File *file = checker->file;
    int64_t count = (int64_t)n, points = degree + 1, each = points * file->dof;
    int64_t width = options->joint_error != NULL || state->growing > 0 ? file->dof + 3 * state->growing : 0;
    const double *t0 = options->t0, *t1 = options->t1;
    double *fractions = workspace->fractions, *q = workspace->slopes;
    int64_t *pairs = workspace->found_pairs;
    for (size_t k = 0; width > 0 && k < n; k++)
        write_off(checker, workspace->courses + (int64_t)k * each, points, options->joint_error,
                  t0 == NULL ? 0 : t0[first + k], t1 == NULL ? 0 : t1[first + k], 0,
                  workspace->off + (int64_t)k * width);
    TRY(certify(workspace, workspace->courses, count, points, width, options->tolerance, 1, options->steps, verdicts));
    write_steps(workspace, options, first, n);
    for (int64_t k = 0; k < count; k++) {
        const double *course = workspace->courses + k * each;
        int8_t found;
        if (verdicts[k] == CODE_TOO_LONG) {
            verdicts[k] = LOEWNER_AMBIGUOUS;
            fractions[k] = 0;
            pairs[k] = -1;
        } else if (verdicts[k] == CODE_BY_CARE ||
                   (verdicts[k] == LOEWNER_COLLIDING && (degree > 1 || file->quaternion_count > 0))) {
            /* Report COLLIDING only if the configuration that users compute from the fraction also collides. */
            evaluate(file, course, degree, fractions[k], q);
            TRY(collide(workspace, CODE_EXACT, q, 1, &found));
            verdicts[k] = found == LOEWNER_COLLIDING ? LOEWNER_COLLIDING : LOEWNER_AMBIGUOUS;
        } else if (verdicts[k] == LOEWNER_FREE && state->starts_matter) {
            TRY(collide(workspace, CODE_EXACT, course, 1, &found));
            if (found == LOEWNER_FREE)
                continue;
            TRY(worst_pair(workspace, course, &verdicts[k], &pairs[k]));
            verdicts[k] = verdicts[k] == LOEWNER_FREE ? LOEWNER_AMBIGUOUS : verdicts[k];
            fractions[k] = 0;
        }
    }
    return LOEWNER_OK;
}

loewner_status take_errors(const loewner_checker *checker, const double **joint_error)
{
    int64_t dof = checker->file->dof;
    for (int64_t c = 0; *joint_error != NULL && c < dof; c++)
        REQUIRE((*joint_error)[c] >= 0 && (*joint_error)[c] < INFINITY, "joint_error: expected numbers >= 0, found %g",
                (*joint_error)[c]);
    *joint_error = if_any(*joint_error, dof);
    return LOEWNER_OK;
}

/* Check options, and replace omitted options by their defaults. The times `t0` and `t1` are used only if both are
   given. */
static loewner_status take_options(const loewner_checker *checker, const loewner_proof_options *options,
                                   loewner_proof_options *taken)
{
    *taken = options == NULL ? (loewner_proof_options){0} : *options;
    REQUIRE(taken->tolerance >= 0 && taken->tolerance < INFINITY, "tolerance: expected a number >= 0, found %g",
            taken->tolerance);
    REQUIRE(taken->steps >= 0, "steps: expected a number >= 0, found %lld", (long long)taken->steps);
    TRY(take_errors(checker, &taken->joint_error));
    taken->tolerance = taken->tolerance > 0 ? taken->tolerance : TOLERANCE;
    taken->steps = steps_of(taken->steps);
    if (taken->t0 == NULL || taken->t1 == NULL)
        taken->t0 = taken->t1 = NULL;
    return LOEWNER_OK;
}

/* Check the times of motions. Times are required if the bounds of a body include a positive speed or turn. */
static loewner_status check_times(const loewner_checker *checker, const loewner_proof_options *options, size_t n)
{
    const State *state = &checker->state;
    const double *t0 = options->t0, *t1 = options->t1;
    for (size_t k = 0; t0 != NULL && k < n; k++)
        REQUIRE(t0[k] <= t1[k] && fabs(t0[k]) < INFINITY && fabs(t1[k]) < INFINITY,
                "t0, t1: expected finite times, t0 <= t1, found %g and %g", t0[k], t1[k]);
    for (int64_t place = state->moving; t0 == NULL && place < state->moving + state->standing; place++) {
        const Body *body = checker->bodies + state->body[place];
        REQUIRE(!body->has_bounds || !(body->bounds.speed > 0 || body->bounds.turn > 0),
                "t0, t1: expected times, since bounds on %.100s grow, found NULL", body->name);
    }
    return LOEWNER_OK;
}

size_t write_courses(loewner_workspace *workspace, const double *starts, const double *ends, size_t first, size_t n)
{
    const File *file = workspace->checker->file;
    size_t dof = (size_t)file->dof, count = at_most(n - first, MOTIONS_AT_ONCE);
    for (size_t k = 0; k < count; k++)
        straight(file, starts + (first + k) * dof, ends + (first + k) * dof, workspace->courses + 2 * k * dof);
    return count;
}

/* Compute proven verdicts for curves, or for motions between configurations, one block after another. For motions,
   `points` holds the start configurations; for curves, it holds the control points, and `ends` is NULL. */
static loewner_status prove_all(loewner_workspace *workspace, const double *points, const double *ends, size_t n,
                                int32_t degree, const loewner_proof_options *options, int8_t *verdicts,
                                double *fractions, int32_t (*bodies)[2])
{
    const loewner_checker *checker = workspace->checker;
    size_t each = (size_t)checker->file->dof * (size_t)(degree + 1);
    loewner_proof_options taken;
    TRY(take_options(checker, options, &taken));
    TRY(expect_pointer(verdicts, n, "verdicts"));
    TRY(check_times(checker, &taken, n));
    for (size_t first = 0; first < n; first += MOTIONS_AT_ONCE) {
        size_t count = at_most(n - first, MOTIONS_AT_ONCE);
        if (ends == NULL)
            memcpy(workspace->courses, points + first * each, count * each * sizeof *points);
        else
            write_courses(workspace, points, ends, first, n);
        TRY(prove(workspace, first, count, degree, &taken, verdicts + first));
        if (fractions != NULL)
            memcpy(fractions + first, workspace->fractions, count * sizeof *fractions);
        for (size_t k = 0; bodies != NULL && k < count; k++)
            write_bodies(&checker->state, workspace->found_pairs[k], bodies[first + k]);
    }
    return LOEWNER_OK;
}

loewner_status loewner_checker_certify_edges(const loewner_checker *checker, loewner_workspace *workspace,
                                             const double *starts, const double *ends, size_t n,
                                             const loewner_proof_options *options, int8_t *verdicts, double *fractions,
                                             int32_t (*bodies)[2])
{
    HOLD_PREPARED(checker, workspace, prepare);
    TRY(check_configurations(checker, starts, n, "starts"));
    TRY(check_configurations(checker, ends, n, "ends"));
    return prove_all(workspace, starts, ends, n, 1, options, verdicts, fractions, bodies);
}

loewner_status loewner_checker_certify_curves(const loewner_checker *checker, loewner_workspace *workspace,
                                              const double *points, size_t n, int32_t degree,
                                              const loewner_proof_options *options, int8_t *verdicts, double *fractions,
                                              int32_t (*bodies)[2])
{
    HOLD_PREPARED(checker, workspace, prepare);
    REQUIRE(degree >= 1 && degree < CODE_MOST_POINTS, "degree: expected 1 to %d, found %d", CODE_MOST_POINTS - 1,
            degree);
    REQUIRE(checker->file->quaternion_count == 0,
            "expected a robot without quaternions: curves of orientations are Python's");
    TRY(check_count(n, (size_t)checker->file->dof * (size_t)(degree + 1), "points"));
    TRY(check_configurations(checker, points, n * (size_t)(degree + 1), "points"));
    return prove_all(workspace, points, NULL, n, degree, options, verdicts, fractions, bodies);
}

/* Determine which of the straight courses in the workspace are free. */
static loewner_status find_free(loewner_workspace *workspace, int64_t count, const loewner_proof_options *options,
                                int8_t *is_free)
{
    const loewner_checker *checker = workspace->checker;
    int64_t dof = checker->file->dof, is_ready = workspace->is_ready;
    for (int64_t k = 0; k < count; k++)
        workspace->work[WORK * k + WORK - 1] = options->steps;
    workspace->is_ready = 0;
    TRY(CALL(free_motions, NULL, .prepared = is_ready, .stop = count, .courses = {workspace->courses, count, 2, dof},
             .error = (int64_t)options->joint_error, .tolerance = options->tolerance, MOTIONS(half_of(checker, CUT)),
             .tallies = {workspace->work, count, WORK}, .out = {is_free, count}, .memory = workspace->validator));
    workspace->is_ready = 1;
    for (int64_t k = 0; checker->state.starts_matter && k < count; k++)
        if (is_free[k]) {
            int8_t found;
            TRY(collide(workspace, CODE_EXACT, workspace->courses + 2 * k * dof, 1, &found));
            is_free[k] = found == LOEWNER_FREE;
        }
    return LOEWNER_OK;
}

loewner_status loewner_checker_motions_free(const loewner_checker *checker, loewner_workspace *workspace,
                                            const double *starts, const double *ends, size_t n,
                                            const loewner_proof_options *options, int8_t *is_free)
{
    loewner_proof_options taken;
    HOLD_PREPARED(checker, workspace, prepare_exact);
    TRY(check_configurations(checker, starts, n, "starts"));
    TRY(check_configurations(checker, ends, n, "ends"));
    TRY(take_options(checker, options, &taken));
    TRY(expect_pointer(is_free, n, "is_free"));
    for (size_t first = 0; first < n; first += MOTIONS_AT_ONCE) {
        size_t count = write_courses(workspace, starts, ends, first, n);
        TRY(find_free(workspace, (int64_t)count, &taken, is_free + first));
        write_steps(workspace, &taken, first, count);
    }
    return LOEWNER_OK;
}
