/* Queries about configurations and motions of a checker; the counterparts in Python are
   `loewner/robots/checking/verdicts.py`, `proofs.py` and `distances.py`. */

#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

_Static_assert(CODE_FREE == LOEWNER_FREE && CODE_COLLIDING == LOEWNER_COLLIDING && CODE_AMBIGUOUS == LOEWNER_AMBIGUOUS,
               "verdicts have the numbers of codes.py");

/* -- arguments ----------------------------------------------------------------------------------------------------- */

loewner_status check_count(size_t n, size_t doubles, const char *name)
{
    /* The limit `most` is more than any address space holds. */
    const size_t most = ((size_t)1 << 56) / sizeof(double) / doubles;
    if (n > most)
        return fail(LOEWNER_BAD_ARGUMENT, "%s: expected at most %zu, found %zu", name, most, n);
    return LOEWNER_OK;
}

loewner_status check_poses(const double *poses, size_t n, const char *name)
{
    struct first_fault_results fault = {0};
    TRY(check_count(n, 16, name));
    if (poses == NULL && n > 0)
        return fail(LOEWNER_BAD_ARGUMENT, "%s: expected poses, found NULL", name);
    TRY(CALL(first_fault, &fault, .Ts = {poses, (int64_t)n, 4, 4}));
    static const char *const faults[] = {
        "rigid",        "not finite", "with another last row than 0 0 0 1", "whose rotation is not orthonormal",
        "a reflection",
    };
    if (fault.k < (int64_t)n)
        return fail(LOEWNER_BAD_ARGUMENT, "%s[%lld]: expected a rigid motion, found one %s", name, (long long)fault.k,
                    faults[fault.kind >= 0 && fault.kind <= 4 ? fault.kind : 0]);
    return LOEWNER_OK;
}

loewner_status check_configurations(const loewner_checker *checker, const double *configurations, size_t n,
                                    const char *name)
{
    const File *file = checker->file;
    size_t count = n * (size_t)file->dof;
    int is = 1;
    TRY(check_count(n, (size_t)file->dof, name));
    if (configurations == NULL && n > 0)
        return fail(LOEWNER_BAD_ARGUMENT, "%s: expected configurations, found NULL", name);
    for (size_t k = 0; k < count; k++)
        is &= fabs(configurations[k]) <= LARGEST_VALUE; /* The comparison is false for NaN. */
    for (size_t k = 0; !is && k < count; k++)
        if (!(fabs(configurations[k]) <= LARGEST_VALUE)) {
            size_t dof = (size_t)file->dof;
            return fail(LOEWNER_BAD_ARGUMENT, "%s[%zu]: expected finite numbers within %g, found %g for %.100s", name,
                        k / dof, LARGEST_VALUE, configurations[k],
                        loewner_checker_value_name(checker, (int32_t)(k % dof)));
        }
    for (int64_t c = 0; c < file->quaternion_count; c++)
        for (size_t k = 0; k < n; k++) {
            const double *q = configurations + k * (size_t)file->dof + file->quaternions[c];
            double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
            if (fabs(norm - 1) > QUATERNION_TOLERANCE)
                return fail(LOEWNER_BAD_ARGUMENT, "%s: expected quaternions of norm 1, found norm %.9g", name, norm);
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

/* Compute exact verdicts for all pairs, with all bodies at the given poses. */
static loewner_status settle_pairs(const State *state, loewner_workspace *workspace, const double *poses,
                                   int8_t *verdicts)
{
    int64_t bodies = state->moving + state->standing, count = state->pairs, plan[5] = {count, 1, 1, 1, 1};
    int64_t pack = (int64_t)&state->halves[WHOLE].pieces;
    memset(verdicts, LOEWNER_AMBIGUOUS, (size_t)count);
    for (int64_t first = 0, last; first < count; first = last) {
        for (last = first + 1; last < count && state->margins[last] == state->margins[first];)
            last++;
        int64_t tally[CODE_TIERS] = {0};
        int are_rigid;
        const struct settle_range asked = {
            .mode = CODE_EXACT, .margin = state->margins[first], .start = first, .stop = last, .plan = {plan, 5, 1},
            .rows = {state->rows, 2, count}, .pack_a = pack, .Ta = {poses, bodies, 4, 4}, .pack_b = pack,
            .Tb = {poses, bodies, 4, 4}, .out = {verdicts, count}, .tally = {tally, CODE_TIERS},
            .memory = workspace->memory,
        };
        TRY(settle_all(&asked, &are_rigid));
        if (!are_rigid) /* An overflow has distorted a pose. */
            memset(verdicts + first, LOEWNER_AMBIGUOUS, (size_t)(last - first));
    }
    return LOEWNER_OK;
}

static int8_t worst(const int8_t *verdicts, int64_t count)
{
    int8_t found = LOEWNER_FREE;
    for (int64_t k = 0; k < count; k++) {
        if (verdicts[k] == LOEWNER_COLLIDING)
            return LOEWNER_COLLIDING;
        if (verdicts[k] == LOEWNER_AMBIGUOUS)
            found = LOEWNER_AMBIGUOUS;
    }
    return found;
}

/* Compute the poses of all bodies from the poses of the links. */
static void place_bodies(const State *state, const double *links, double *poses)
{
    for (int64_t k = 0; k < state->moving; k++)
        memcpy(poses + 16 * k, links + 16 * state->link[k], 16 * sizeof(double));
    memcpy(poses + 16 * state->moving, state->poses, (size_t)state->standing * 16 * sizeof(double));
}

static loewner_status settle_one(const loewner_checker *checker, loewner_workspace *workspace, const double *q,
                                 int8_t *verdicts)
{
    const State *state = &checker->state;
    TRY(place_links(&state->tree, q, 1, checker->file->dof, workspace->link_poses));
    place_bodies(state, workspace->link_poses, workspace->poses);
    return settle_pairs(state, workspace, workspace->poses, verdicts);
}

loewner_status worst_pair(const loewner_checker *checker, loewner_workspace *workspace, const double *q,
                          int8_t *verdict, int64_t *pair)
{
    TRY(settle_one(checker, workspace, q, workspace->pair_verdicts));
    *verdict = worst(workspace->pair_verdicts, checker->state.pairs);
    *pair = -1;
    for (int64_t p = checker->state.pairs - 1; p >= 0 && *verdict != LOEWNER_FREE; p--)
        if (workspace->pair_verdicts[p] == *verdict)
            *pair = p;
    return LOEWNER_OK;
}

/* Move the pairs that have collided most often to the front. */
static void learn(const State *state, loewner_workspace *workspace, size_t n)
{
    workspace->seen += (int64_t)n;
    if (workspace->seen < workspace->next_look)
        return;
    workspace->next_look = 2 * workspace->seen;
    /* A stable insertion sort suffices, because few pairs ever collide, and these are soon in front. */
    for (int64_t k = 0; k < state->pairs; k++)
        workspace->order[k] = k;
    for (int64_t k = 1; k < state->pairs; k++) {
        int64_t pair = workspace->order[k], at = k;
        if (workspace->hits[pair] == 0)
            continue;
        while (at > 0 && workspace->hits[workspace->order[at - 1]] < workspace->hits[pair])
            at--;
        memmove(workspace->order + at + 1, workspace->order + at, (size_t)(k - at) * 8);
        workspace->order[at] = pair;
    }
}

loewner_status collide(const loewner_checker *checker, loewner_workspace *workspace, int mode,
                       const double *configurations, size_t n, int8_t *verdicts)
{
    const State *state = &checker->state;
    int64_t dof = checker->file->dof;
    for (size_t first = 0; first < n; first += CHUNK) {
        int64_t count = (int64_t)(n - first < CHUNK ? n - first : CHUNK);
        const double *rows = configurations + first * (size_t)dof;
        TRY(CALL(check_configurations, NULL, .mode = mode == HASTY ? CODE_EXACT : mode, .stop = count,
                 .Q = {rows, count, dof}, .pack = workspace->pack, .problem_handle = (int64_t)&workspace->tables,
                 .out = {verdicts + first, count}, .tiers_out = {workspace->tiers, count},
                 .hits = {workspace->hits, state->pairs}, .memory = workspace->memory));
        for (int64_t k = 0; mode == CODE_EXACT && k < count; k++)
            if (verdicts[first + (size_t)k] == LOEWNER_AMBIGUOUS) {
                TRY(settle_one(checker, workspace, rows + k * dof, workspace->pair_verdicts));
                verdicts[first + (size_t)k] = worst(workspace->pair_verdicts, state->pairs);
            }
        learn(state, workspace, (size_t)count);
    }
    return LOEWNER_OK;
}

static loewner_status asked(const loewner_checker *checker, loewner_workspace *workspace, int mode,
                            const double *configurations, size_t n, int8_t *verdicts)
{
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    TRY(check_configurations(checker, configurations, n, "configurations"));
    if (verdicts == NULL && n > 0)
        return fail(LOEWNER_BAD_ARGUMENT, "verdicts: expected a pointer, found NULL");
    return collide(checker, workspace, mode, configurations, n, verdicts);
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
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    TRY(check_configurations(checker, configuration, 1, "configuration"));
    if (verdicts == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "verdicts: expected a pointer, found NULL");
    return settle_one(checker, workspace, configuration, verdicts);
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
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    const State *state = &checker->state;
    int64_t links = checker->file->links;
    TRY(check_poses(link_poses, (size_t)links, "link_poses"));
    if (verdict == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "verdict: expected a pointer, found NULL");
    memcpy(workspace->link_poses, link_poses, (size_t)links * 16 * sizeof(double));
    /* Attached bodies have links of their own, which follow the links of the robot. */
    for (int64_t k = 0; k < state->moving; k++) {
        const Body *body = checker->bodies + state->body[k];
        if (body->is_attached)
            multiply(link_poses + 16 * body->link, body->pose, workspace->link_poses + 16 * state->link[k]);
    }
    int8_t *out = verdicts != NULL ? verdicts : workspace->pair_verdicts;
    place_bodies(state, workspace->link_poses, workspace->poses);
    TRY(settle_pairs(state, workspace, workspace->poses, out));
    *verdict = worst(out, state->pairs);
    return LOEWNER_OK;
}

loewner_status loewner_checker_link_poses(const loewner_checker *checker, const double *configurations, size_t n,
                                          double *poses)
{
    if (checker == NULL || (n > 0 && poses == NULL))
        return fail(LOEWNER_BAD_ARGUMENT, "checker, poses: expected pointers, found NULL");
    TRY(check_configurations(checker, configurations, n, "configurations"));
    return place_links(&checker->file->tree, configurations, (int64_t)n, checker->file->dof, poses);
}

/* -- distances ----------------------------------------------------------------------------------------------------- */

/* Return the body of a piece. */
static int64_t owner(const struct pieces *pieces, int64_t piece)
{
    const int64_t *start = pieces->piece_start.data;
    int64_t low = 0, high = pieces->piece_start.rows - 1;
    while (high - low > 1) {
        int64_t middle = (low + high) / 2;
        if (start[middle] <= piece)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static loewner_status differentiate(const loewner_checker *checker, loewner_workspace *workspace, const double *rows,
                                    int64_t count, double *gradients)
{
    int64_t dof = checker->file->dof;
    return CALL(pair_gradients, NULL, .stop = count, .Q = {rows, count, dof}, .pack = workspace->pack,
                .problem_handle = (int64_t)&workspace->tables, .memory = workspace->memory,
                .bodies = {workspace->pieces, count, 2}, .force = {workspace->vectors + 6 * count, count, 3},
                .point = {workspace->vectors, count, 3}, .slopes = {gradients, count, dof});
}

loewner_status loewner_checker_distance(const loewner_checker *checker, loewner_workspace *workspace,
                                        const double *configurations, size_t n, loewner_distance *distances,
                                        double *gradients)
{
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    TRY(check_configurations(checker, configurations, n, "configurations"));
    const State *state = &checker->state;
    int64_t dof = checker->file->dof;
    if (state->pairs == 0 || (distances == NULL && n > 0))
        return fail(LOEWNER_BAD_ARGUMENT, "expected pairs to check and a place for distances, found none");
    for (size_t first = 0; first < n; first += MOTIONS_AT_ONCE) {
        int64_t count = (int64_t)(n - first < MOTIONS_AT_ONCE ? n - first : MOTIONS_AT_ONCE);
        const double *rows = configurations + first * (size_t)dof;
        int8_t *status = workspace->found;
        double *numbers = workspace->numbers, *vectors = workspace->vectors;
        TRY(CALL(nearest_pairs, NULL, .wanted = 1, .stop = count, .Q = {rows, count, dof}, .pack = workspace->pack,
                 .problem_handle = (int64_t)&workspace->tables, .memory = workspace->memory,
                 .numbers = {numbers, 3, count}, .vectors = {vectors, 3, count, 3},
                 .pieces_out = {workspace->pieces, count, 2}, .status = {status, count}));
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
        TRY(differentiate(checker, workspace, rows, count, slopes));
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
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    TRY(check_configurations(checker, configurations, n, "configurations"));
    const State *state = &checker->state;
    if (state->pairs == 0 || (clearances == NULL && n > 0))
        return fail(LOEWNER_BAD_ARGUMENT, "expected pairs to check and a place for clearances, found none");
    if (!(softness > 0 && softness < INFINITY))
        return fail(LOEWNER_BAD_ARGUMENT, "softness: expected a positive number, found %g", softness);
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

void straight(const loewner_checker *checker, const double *a, const double *b, double *course)
{
    const File *file = checker->file;
    size_t size = sizeof(double) * (size_t)file->dof;
    memcpy(course, a, size);
    memcpy(course + file->dof, b, size);
    for (int64_t c = 0; c < file->quaternion_count; c++) { /* Take q or -q: the nearer one. */
        const double *p = a + file->quaternions[c];
        double *q = course + file->dof + file->quaternions[c];
        if (p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3] < 0)
            for (int k = 0; k < 4; k++)
                q[k] = -q[k];
    }
}

/* Return an elementary function of a number, with the same bits as in Python. */
static double elementary(int64_t function, double x)
{
    double result = NAN;
    CALL(elementary, NULL, .function = function, .x = {&x, 1}, .y = {&x, 1}, .result = {&result, 1});
    return result;
}

/* Write an orientation on the shorter arc from p to q, as `Robot.between` does. */
static void slerp(const double *p, const double *q, double t, double *made)
{
    double cosine = fmin(p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3], 1.0);
    double angle = elementary(CODE_ARC_COSINE, cosine), of_p = 1 - t, of_q = t, norm = 0;
    if (angle >= 1e-6) {
        double sine = fmax(elementary(CODE_SINE_OF, angle), 1e-12);
        of_p = elementary(CODE_SINE_OF, (1 - t) * angle) / sine;
        of_q = elementary(CODE_SINE_OF, t * angle) / sine;
    }
    for (int k = 0; k < 4; k++)
        made[k] = of_p * p[k] + of_q * q[k];
    for (int k = 0; k < 4; k++)
        norm += made[k] * made[k];
    for (int k = 0; k < 4; k++)
        made[k] /= sqrt(norm);
}

/* Use only products, in the order of `_matrices.power`, because the last bit of `pow` depends on the C library. */
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
    for (int64_t c = 0; c < file->quaternion_count; c++) {
        double *its = q + file->quaternions[c], norm = 0;
        for (int k = 0; k < 4; k++)
            norm += its[k] * its[k];
        for (int k = 0; k < 4; k++)
            its[k] /= sqrt(norm);
    }
}

loewner_status certify(const loewner_checker *checker, loewner_workspace *workspace, double *courses, int64_t count,
                       int64_t points, double *off, int64_t width, double tolerance, int64_t as_given, int64_t steps,
                       int64_t *work, int8_t *verdicts, double *fractions, int64_t *pairs)
{
    const Half *half = half_of(checker, CUT);
    for (int64_t k = 0; k < count; k++) {
        work[WORK * k + WORK - 1] = steps;
        verdicts[k] = (int8_t)as_given;
    }
    /* `clear` is omitted, because bodies may be as near as their margins. */
    return CALL(certify_motions, NULL, .stop = count, .courses = {courses, count, points, checker->file->dof},
                .off = {off, width > 0 ? count : 0, width}, .tolerance = tolerance, .pack = (int64_t)&half->pieces,
                .problem_handle = half->handle, .tables_handle = half->motions, .out = {verdicts, count},
                .t_out = {fractions, count}, .pair_out = {pairs, count}, .tallies = {work, count, WORK},
                .memory = workspace->memory);
}

/* Bound the deviation of a body's points at a time that may be off by `late` [s]. The bound leaves more than enough
   room for rounding (B69). */
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
    return fmin(off * (1 + 0x1p-44), 1e100); /* The result is 1e100 for NaN, too. */
}

/* Write the deviations of bodies, in the form that the kernel takes, after the values of a motion. */
static void write_growth(const loewner_checker *checker, double t0, double t1, double late, double *row)
{
    const State *state = &checker->state;
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

void write_off(const loewner_checker *checker, const double *course, int64_t points, const double *joint_error,
               double t0, double t1, double late, double *row)
{
    int64_t dof = checker->file->dof;
    for (int64_t c = 0; c < dof; c++) {
        double most = 0;
        for (int64_t p = 0; p < points; p++)
            most = fmax(most, fabs(course[p * dof + c]));
        row[c] = joint_error != NULL ? joint_error[c] + ROUNDED_VALUES * most : 0;
    }
    write_growth(checker, t0, t1, late, row + dof);
}

loewner_status prove(const loewner_checker *checker, loewner_workspace *workspace, double *courses, size_t n,
                     int32_t degree, double tolerance, const double *joint_error, const double *t0, const double *t1,
                     int64_t steps, int8_t *verdicts, double *fractions, int64_t *pairs)
{
    const State *state = &checker->state;
    const File *file = checker->file;
    int64_t dof = file->dof, count = (int64_t)n, points = degree + 1, width = dof + 3 * state->growing;
    int is_off = 0;
    for (int64_t c = 0; joint_error != NULL && c < dof; c++)
        is_off |= joint_error[c] > 0;
    int is_wide = is_off || state->growing > 0;
    for (int64_t k = 0; is_wide && k < count; k++)
        write_off(checker, courses + k * points * dof, points, is_off ? joint_error : NULL, t0 == NULL ? 0 : t0[k],
                  t1 == NULL ? 0 : t1[k], 0, workspace->off + k * width);
    TRY(certify(checker, workspace, courses, count, points, workspace->off, is_wide ? width : 0, tolerance, 1, steps,
                workspace->work, verdicts, fractions, pairs));
    double *q = workspace->slopes;
    for (int64_t k = 0; k < count; k++) {
        const double *course = courses + k * points * dof;
        if (verdicts[k] == CODE_TOO_LONG) {
            verdicts[k] = LOEWNER_AMBIGUOUS;
            fractions[k] = 0;
            pairs[k] = -1;
        } else if (verdicts[k] == CODE_BY_CARE ||
                   (verdicts[k] == LOEWNER_COLLIDING && (degree > 1 || file->quaternion_count > 0))) {
            /* A motion is COLLIDING only if the configuration that a user computes from the fraction collides. */
            int8_t found;
            evaluate(file, course, degree, fractions[k], q);
            TRY(collide(checker, workspace, CODE_EXACT, q, 1, &found));
            verdicts[k] = found == LOEWNER_COLLIDING ? LOEWNER_COLLIDING : LOEWNER_AMBIGUOUS;
        } else if (verdicts[k] == LOEWNER_FREE && state->starts_matter) {
            int8_t found;
            TRY(collide(checker, workspace, CODE_EXACT, course, 1, &found));
            if (found == LOEWNER_FREE)
                continue;
            TRY(worst_pair(checker, workspace, course, &verdicts[k], &pairs[k]));
            verdicts[k] = verdicts[k] == LOEWNER_FREE ? LOEWNER_AMBIGUOUS : verdicts[k];
            fractions[k] = 0;
        }
    }
    return LOEWNER_OK;
}

static loewner_status check_options(const loewner_checker *checker, const loewner_proof_options *options)
{
    if (options == NULL)
        return LOEWNER_OK;
    if (!(options->tolerance >= 0 && options->tolerance < INFINITY))
        return fail(LOEWNER_BAD_ARGUMENT, "tolerance: expected a number >= 0, found %g", options->tolerance);
    if (options->steps < 0)
        return fail(LOEWNER_BAD_ARGUMENT, "steps: expected a number >= 0, found %lld", (long long)options->steps);
    for (int64_t c = 0; options->joint_error != NULL && c < checker->file->dof; c++)
        if (!(options->joint_error[c] >= 0 && options->joint_error[c] < INFINITY))
            return fail(LOEWNER_BAD_ARGUMENT, "joint_error: expected numbers >= 0, found %g", options->joint_error[c]);
    return LOEWNER_OK;
}

/* Check the times of motions, which are required for bodies with a speed or a turn. */
static loewner_status check_times(const loewner_checker *checker, const loewner_proof_options *options, size_t n)
{
    const State *state = &checker->state;
    int is_timed = options != NULL && options->t0 != NULL && options->t1 != NULL;
    for (size_t k = 0; is_timed && k < n; k++)
        if (!(options->t0[k] <= options->t1[k] && fabs(options->t0[k]) < INFINITY && fabs(options->t1[k]) < INFINITY))
            return fail(LOEWNER_BAD_ARGUMENT, "t0, t1: expected finite times, t0 <= t1, found %g and %g",
                        options->t0[k], options->t1[k]);
    for (int64_t place = state->moving; !is_timed && place < state->moving + state->standing; place++) {
        const Body *body = checker->bodies + state->body[place];
        if (body->has_bounds && (body->bounds.speed > 0 || body->bounds.turn > 0))
            return fail(LOEWNER_BAD_ARGUMENT, "t0, t1: expected times, since bounds on %.100s grow, found NULL",
                        body->name);
    }
    return LOEWNER_OK;
}

static loewner_status check_edges(const loewner_checker *checker, const double *starts, const double *ends, size_t n,
                                  const loewner_proof_options *options, const int8_t *answers, const char *name)
{
    TRY(check_configurations(checker, starts, n, "starts"));
    TRY(check_configurations(checker, ends, n, "ends"));
    TRY(check_options(checker, options));
    if (answers == NULL && n > 0)
        return fail(LOEWNER_BAD_ARGUMENT, "%s: expected a pointer, found NULL", name);
    return LOEWNER_OK;
}

/* Write the courses of the next batch of motions, which starts at `first`, and return the size of the batch. */
static size_t write_courses(const loewner_checker *checker, loewner_workspace *workspace, const double *starts,
                            const double *ends, size_t first, size_t n)
{
    size_t dof = (size_t)checker->file->dof, count = n - first < MOTIONS_AT_ONCE ? n - first : MOTIONS_AT_ONCE;
    for (size_t k = 0; k < count; k++)
        straight(checker, starts + (first + k) * dof, ends + (first + k) * dof, workspace->courses + 2 * k * dof);
    return count;
}

/* Limit on the steps for each motion. */
static int64_t steps_of(const loewner_proof_options *options)
{
    return options != NULL && options->steps > 0 && options->steps < CODE_NO_LIMIT ? options->steps : CODE_NO_LIMIT;
}

/* Write how many steps each motion took; `first` is the index of the first motion. */
static void write_steps(const loewner_workspace *workspace, const loewner_proof_options *options, size_t first,
                        size_t count)
{
    for (size_t k = 0; options != NULL && options->steps_taken != NULL && k < count; k++)
        options->steps_taken[first + k] = workspace->work[WORK * k + WORK - 1];
}

/* Prove a block of courses in the workspace, and write the requested results. */
static loewner_status prove_block(const loewner_checker *checker, loewner_workspace *workspace, size_t first,
                                  size_t count, int32_t degree, const loewner_proof_options *options, int8_t *verdicts,
                                  double *fractions, int32_t (*bodies)[2])
{
    int is_timed = options != NULL && options->t0 != NULL && options->t1 != NULL;
    TRY(prove(checker, workspace, workspace->courses, count, degree,
              options != NULL && options->tolerance > 0 ? options->tolerance : TOLERANCE,
              options != NULL ? options->joint_error : NULL, is_timed ? options->t0 + first : NULL,
              is_timed ? options->t1 + first : NULL, steps_of(options), verdicts, workspace->fractions,
              workspace->found_pairs));
    if (fractions != NULL)
        memcpy(fractions, workspace->fractions, count * sizeof *fractions);
    for (size_t k = 0; bodies != NULL && k < count; k++)
        for (int side = 0; side < 2; side++) {
            int64_t pair = workspace->found_pairs[k];
            bodies[k][side] = pair < 0 ? -1 : checker->state.body[checker->state.pair_list[2 * pair + side]];
        }
    return LOEWNER_OK;
}

loewner_status loewner_checker_certify_edges(const loewner_checker *checker, loewner_workspace *workspace,
                                             const double *starts, const double *ends, size_t n,
                                             const loewner_proof_options *options, int8_t *verdicts, double *fractions,
                                             int32_t (*bodies)[2])
{
    HOLD(workspace);
    TRY(prepare(checker, workspace));
    TRY(check_edges(checker, starts, ends, n, options, verdicts, "verdicts"));
    TRY(check_times(checker, options, n));
    for (size_t first = 0; first < n; first += MOTIONS_AT_ONCE) {
        size_t count = write_courses(checker, workspace, starts, ends, first, n);
        TRY(prove_block(checker, workspace, first, count, 1, options, verdicts + first,
                        fractions == NULL ? NULL : fractions + first, bodies == NULL ? NULL : bodies + first));
        write_steps(workspace, options, first, count);
    }
    return LOEWNER_OK;
}

/* Determine which of the straight courses in the workspace are free. */
static loewner_status find_free(const loewner_checker *checker, loewner_workspace *workspace, int64_t count,
                                const loewner_proof_options *options, int8_t *is_free)
{
    const Half *half = half_of(checker, CUT);
    int64_t dof = checker->file->dof;
    const double *error = options != NULL ? options->joint_error : NULL;
    int is_off = 0;
    for (int64_t c = 0; error != NULL && c < dof; c++)
        is_off |= error[c] > 0;
    for (int64_t k = 0; k < count; k++)
        workspace->work[WORK * k + WORK - 1] = steps_of(options);
    int64_t is_ready = workspace->is_ready;
    workspace->is_ready = 0;
    TRY(CALL(free_motions, NULL, .prepared = is_ready, .stop = count, .courses = {workspace->courses, count, 2, dof},
             .error = is_off ? (int64_t)error : 0,
             .tolerance = options != NULL && options->tolerance > 0 ? options->tolerance : TOLERANCE,
             .pack = (int64_t)&half->pieces, .problem_handle = half->handle, .tables_handle = half->motions,
             .tallies = {workspace->work, count, WORK}, .out = {is_free, count}, .memory = workspace->validator));
    workspace->is_ready = 1;
    for (int64_t k = 0; checker->state.starts_matter && k < count; k++)
        if (is_free[k]) {
            int8_t found;
            TRY(collide(checker, workspace, CODE_EXACT, workspace->courses + 2 * k * dof, 1, &found));
            is_free[k] = found == LOEWNER_FREE;
        }
    return LOEWNER_OK;
}

loewner_status loewner_checker_motions_free(const loewner_checker *checker, loewner_workspace *workspace,
                                            const double *starts, const double *ends, size_t n,
                                            const loewner_proof_options *options, int8_t *is_free)
{
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    TRY(check_edges(checker, starts, ends, n, options, is_free, "is_free"));
    for (size_t first = 0; first < n; first += MOTIONS_AT_ONCE) {
        size_t count = write_courses(checker, workspace, starts, ends, first, n);
        TRY(find_free(checker, workspace, (int64_t)count, options, is_free + first));
        write_steps(workspace, options, first, count);
    }
    return LOEWNER_OK;
}

loewner_status loewner_checker_certify_curves(const loewner_checker *checker, loewner_workspace *workspace,
                                              const double *points, size_t n, int32_t degree,
                                              const loewner_proof_options *options, int8_t *verdicts, double *fractions,
                                              int32_t (*bodies)[2])
{
    HOLD(workspace);
    TRY(prepare(checker, workspace));
    if (degree < 1 || degree >= CODE_MOST_POINTS)
        return fail(LOEWNER_BAD_ARGUMENT, "degree: expected 1 to %d, found %d", CODE_MOST_POINTS - 1, degree);
    size_t each = (size_t)checker->file->dof * (size_t)(degree + 1);
    if (checker->file->quaternion_count > 0)
        return fail(LOEWNER_BAD_ARGUMENT, "expected a robot without quaternions: curves of orientations are Python's");
    TRY(check_count(n, each, "points"));
    TRY(check_configurations(checker, points, n * (size_t)(degree + 1), "points"));
    TRY(check_options(checker, options));
    TRY(check_times(checker, options, n));
    if (verdicts == NULL && n > 0)
        return fail(LOEWNER_BAD_ARGUMENT, "verdicts: expected a pointer, found NULL");
    for (size_t first = 0; first < n; first += MOTIONS_AT_ONCE) {
        size_t count = n - first < MOTIONS_AT_ONCE ? n - first : MOTIONS_AT_ONCE;
        memcpy(workspace->courses, points + first * each, count * each * sizeof *points);
        TRY(prove_block(checker, workspace, first, count, degree, options, verdicts + first,
                        fractions == NULL ? NULL : fractions + first, bodies == NULL ? NULL : bodies + first));
        write_steps(workspace, options, first, count);
    }
    return LOEWNER_OK;
}
