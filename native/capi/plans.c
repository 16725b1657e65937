/* Paths: what `loewner/planners/compiled.py` does, step by step, so that equal seeds give equal paths. */

#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct {
    const loewner_checker *checker;
    loewner_workspace *workspace;
    const double *joint_error; /* NULL for none */
    int64_t handles[7];
    double lengths[2];
} Judge;

typedef struct {
    int64_t count, dof; /* values that move, and all */
    int64_t *columns;   /* count, then whether they turn */
    double *limits;     /* lower, upper, strides, shifts and weights */
    const double *start;
} Space;

typedef struct {
    int64_t capacity;
    double *nodes, *domains, *squares;
    int64_t *parents;
} Trees;

static Judge judge_of(const loewner_checker *checker, loewner_workspace *workspace, const double *joint_error)
{
    const Half *half = half_of(checker, CUT);
    int is_off = 0;
    for (int64_t c = 0; joint_error != NULL && c < checker->file->dof; c++)
        is_off |= joint_error[c] > 0;
    return (Judge){
        checker,
        workspace,
        is_off ? joint_error : NULL,
        {(int64_t)&half->pieces, half->handle, half->motions, (int64_t)workspace->memory, 1,
         is_off ? (int64_t)joint_error : 0, 0},
        {PLAN_TOLERANCE, 0},
    };
}

/* Whether all motions of a path are proven free; `at` receives the first one that is not. */
static loewner_status is_free(const Judge *judge, const double *path, int64_t count, int64_t *at)
{
    const loewner_checker *checker = judge->checker;
    loewner_workspace *workspace = judge->workspace;
    int64_t dof = checker->file->dof;
    *at = -1;
    for (int64_t first = 0; first + 1 < count && *at < 0; first += MOTIONS_AT_ONCE) {
        int64_t motions = count - 1 - first < MOTIONS_AT_ONCE ? count - 1 - first : MOTIONS_AT_ONCE;
        for (int64_t k = 0; k < motions; k++)
            straight(checker, path + (first + k) * dof, path + (first + k + 1) * dof, workspace->courses + 2 * k * dof);
        TRY(prove(checker, workspace, workspace->courses, (size_t)motions, 1, PLAN_TOLERANCE, judge->joint_error, NULL,
                  NULL, CODE_NO_LIMIT, workspace->found, workspace->fractions, workspace->found_pairs));
        for (int64_t k = motions - 1; k >= 0; k--)
            if (workspace->found[k] != LOEWNER_FREE)
                *at = first + k;
    }
    return LOEWNER_OK;
}

/* Whether one configuration is proven free, within the joint error. */
static loewner_status is_free_at(const Judge *judge, const double *q, int *is)
{
    int8_t verdict;
    TRY(collide(judge->checker, judge->workspace, CODE_EXACT, q, 1, &verdict));
    *is = verdict == LOEWNER_FREE;
    if (!*is || judge->joint_error == NULL)
        return LOEWNER_OK;
    double *course = judge->workspace->courses;
    straight(judge->checker, q, q, course);
    TRY(prove(judge->checker, judge->workspace, course, 1, 1, PLAN_TOLERANCE, judge->joint_error, NULL, NULL,
              CODE_NO_LIMIT, &verdict, judge->workspace->fractions, judge->workspace->found_pairs));
    *is = verdict == LOEWNER_FREE;
    return LOEWNER_OK;
}

/* -- the space ----------------------------------------------------------------------------------------------------- */

/* The distance of two points, with the sum in the order of `_matrices.lengths`. */
static double distance_between(const double *a, const double *b, int64_t count)
{
    double squares = 0;
    for (int64_t k = 0; k < count; k++)
        squares += (a[k] - b[k]) * (a[k] - b[k]);
    return sqrt(squares);
}

/* The root of x^(d + 1) = x + 1, between 1 and 2, by products in the order of `_low_discrepancy.py`. */
static double root_of(int64_t dimension)
{
    double low = 1, high = 2;
    for (int step = 0; step < 52; step++) {
        double middle = 0.5 * (low + high), power = 1;
        for (int64_t k = 0; k <= dimension; k++)
            power *= middle;
        *(power < 1 + middle ? &low : &high) = middle;
    }
    return low;
}

static loewner_status space_of(const loewner_checker *checker, const double *start, const double *goals,
                               size_t goal_count, const uint8_t *joints, uint32_t seed, Space *space)
{
    const File *file = checker->file;
    int64_t dof = file->dof, count = 0;
    *space = (Space){.dof = dof, .start = start};
    space->columns = malloc(sizeof(int64_t) * 2 * (size_t)dof);
    space->limits = malloc(sizeof(double) * 5 * (size_t)dof);
    double *bounds = malloc(sizeof(double) * 2 * (size_t)dof);
    loewner_status outcome =
        space->columns == NULL || space->limits == NULL || bounds == NULL ? no_memory() : LOEWNER_OK;
    for (int64_t c = 0; outcome == LOEWNER_OK && c < dof; c++) {
        if (joints != NULL && !joints[c])
            continue;
        if (!(file->joints[c] & JOINT_SINGLE)) {
            outcome = fail(LOEWNER_BAD_ARGUMENT,
                           "joints: expected joints of one value each, found %s, which has no limits "
                           "to search within; name the joints that are to move",
                           loewner_checker_value_name(checker, (int32_t)c));
            break;
        }
        double least = start[c], most = start[c], lower = file->limits[c], upper = file->limits[dof + c];
        for (size_t g = 0; g < goal_count; g++) {
            least = fmin(least, goals[g * (size_t)dof + (size_t)c]);
            most = fmax(most, goals[g * (size_t)dof + (size_t)c]);
        }
        lower = file->joints[c] & JOINT_NO_LOWER ? fmax(least - M_PI, lower) : lower;
        upper = file->joints[c] & JOINT_NO_UPPER ? fmin(most + M_PI, upper) : upper;
        if (!(lower < upper))
            continue;
        space->columns[count] = c;
        bounds[2 * count] = lower;
        bounds[2 * count + 1] = upper;
        count++;
    }
    if (outcome == LOEWNER_OK && count == 0)
        outcome = fail(LOEWNER_BAD_ARGUMENT, "joints: expected one or more that can move, found none");
    if (outcome == LOEWNER_OK) {
        /* Powers of the root of x^(d + 1) = x + 1, and numbers independent of them: `_low_discrepancy.py`. */
        double first = 1 / root_of(count), power = 1;
        space->count = count;
        for (int64_t k = 0; k < count; k++) {
            double *limits = space->limits, whole;
            limits[k] = bounds[2 * k];
            limits[count + k] = bounds[2 * k + 1];
            power *= first;
            limits[2 * count + k] = power;
            limits[3 * count + k] = modf(0.5 + seed * modf(M_PI * sqrt((double)(k + 2)), &whole), &whole);
            limits[4 * count + k] = 1;
            space->columns[count + k] = (file->joints[space->columns[k]] & JOINT_TURNING) != 0;
        }
    }
    free(bounds);
    return outcome;
}

static int is_inside(const Space *space, const double *q)
{
    int is = 1;
    for (int64_t k = 0; k < space->count; k++) {
        double value = q[space->columns[k]];
        is &= value >= space->limits[k] - ON_LIMIT && value <= space->limits[space->count + k] + ON_LIMIT;
    }
    return is;
}

/* -- trees --------------------------------------------------------------------------------------------------------- */

static void leave_trees(Trees *trees)
{
    free(trees->nodes);
    free(trees->domains);
    free(trees->squares);
    free(trees->parents);
}

static loewner_status grow(Trees *trees, int64_t joints, int64_t capacity)
{
    size_t size = sizeof(double) * (size_t)capacity, old = sizeof(double) * (size_t)trees->capacity;
    Trees more = {capacity, malloc(2 * size * (size_t)joints), malloc(2 * size), malloc(size), malloc(2 * size)};
    if (more.nodes == NULL || more.domains == NULL || more.squares == NULL || more.parents == NULL) {
        leave_trees(&more);
        return no_memory();
    }
    for (int64_t row = 0; trees->capacity > 0 && row < 2 * joints; row++)
        memcpy(more.nodes + row * capacity, trees->nodes + row * trees->capacity, old);
    for (int64_t row = 0; trees->capacity > 0 && row < 2; row++) {
        memcpy(more.domains + row * capacity, trees->domains + row * trees->capacity, old);
        memcpy(more.parents + row * capacity, trees->parents + row * trees->capacity, old);
    }
    leave_trees(trees);
    *trees = more;
    return LOEWNER_OK;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Let the trees grow, until they have had `most` iterations in all. */
static loewner_status grow_on(const Judge *judge, const Space *space, Trees *trees, double *reach, int64_t *state,
                              double *gap, double *ends, double *points, int64_t most, int64_t *outcome)
{
    int64_t joints = space->count, dof = space->dof;
    *outcome = CODE_FULL;
    while (*outcome == CODE_FULL) {
        memcpy(ends, space->start, sizeof(double) * (size_t)dof);
        memcpy(ends + dof, space->start, sizeof(double) * (size_t)dof);
        TRY(CALL(connect_trees, outcome, .most = most, .reach = {reach, 2}, .handles = {judge->handles, 7},
                 .lengths = {judge->lengths, 2}, .joints = {space->columns, 2, joints},
                 .limits = {space->limits, 5, joints}, .nodes = {trees->nodes, 2, joints, trees->capacity},
                 .parents = {trees->parents, 2, trees->capacity}, .domains = {trees->domains, 2, trees->capacity},
                 .state = {state, STATE}, .gap = {gap, 1}, .ends = {ends, 2, dof}, .points = {points, 4, joints},
                 .squares = {trees->squares, trees->capacity}));
        if (*outcome == CODE_FULL)
            TRY(grow(trees, joints, 2 * trees->capacity));
    }
    return LOEWNER_OK;
}

/* Room for a path in the workspace. */
static loewner_status make_room(loewner_workspace *workspace, int64_t rows, int64_t dof)
{
    size_t needed = (size_t)(rows * dof);
    if (workspace->path_room < needed) {
        double *more = realloc(workspace->path, needed * sizeof *more);
        if (more == NULL)
            return no_memory();
        workspace->path = more;
        workspace->path_room = needed;
    }
    return LOEWNER_OK;
}

static int64_t length_of_branch(const Trees *trees, int tree, int64_t node)
{
    int64_t length = 0;
    for (; node >= 0; node = trees->parents[tree * trees->capacity + node])
        length++;
    return length;
}

/* Write the values of a node into a row of a path. */
static void copy_node(const Space *space, const Trees *trees, int tree, int64_t node, double *row)
{
    for (int64_t k = 0; k < space->count; k++)
        row[space->columns[k]] = trees->nodes[(tree * space->count + k) * trees->capacity + node];
}

/* Write the path through both trees to the workspace. */
static loewner_status write_path(const Judge *judge, const Space *space, const Trees *trees, const int64_t *state,
                                 int64_t *count)
{
    int64_t joints = space->count, dof = space->dof, first = length_of_branch(trees, 0, state[OF_START]);
    int64_t total = first + length_of_branch(trees, 1, state[OF_GOAL]), row = first;
    TRY(make_room(judge->workspace, total, dof));
    double *path = judge->workspace->path;
    for (int64_t k = 0; k < total; k++)
        memcpy(path + k * dof, space->start, sizeof(double) * (size_t)dof);
    for (int64_t node = state[OF_START]; node >= 0; node = trees->parents[node])
        copy_node(space, trees, 0, node, path + dof * --row);
    row = first;
    for (int64_t node = state[OF_GOAL]; node >= 0; node = trees->parents[trees->capacity + node])
        copy_node(space, trees, 1, node, path + dof * row++);
    int turned = 0;
    for (int64_t k = 0; k < joints; k++) {
        int64_t c = space->columns[k];
        double turns =
            space->columns[joints + k] ? rint((path[first * dof + c] - path[(first - 1) * dof + c]) / (2 * M_PI)) : 0;
        for (row = first; turns != 0 && row < total; row++)
            path[row * dof + c] -= 2 * M_PI * turns;
        turned |= turns != 0;
    }
    *count = total;
    if (!turned && !judge->checker->state.starts_matter)
        return LOEWNER_OK;
    int64_t found;
    TRY(is_free(judge, path, total, &found));
    return found < 0 ? LOEWNER_OK
                     : fail(LOEWNER_NO_PATH, "expected a path that is free as a whole; another seed may help");
}

static loewner_status connect(const Judge *judge, const Space *space, const double *goals, size_t goal_count,
                              uint32_t seed, int64_t max_iterations, double timeout, int64_t *count)
{
    int64_t joints = space->count, state[STATE] = {0}, outcome = CODE_SPENT, portion = FIRST_ITERATIONS;
    double gap = INFINITY, *limits = space->limits, *ends = malloc(sizeof(double) * 2 * (size_t)space->dof);
    double *points = malloc(sizeof(double) * 4 * (size_t)joints);
    Trees trees = {0};
    loewner_status status = ends == NULL || points == NULL ? no_memory() : LOEWNER_OK;
    for (int64_t k = 0; k < joints; k++)
        if (space->columns[joints + k]) {
            limits[k] = space->start[space->columns[k]] - M_PI;
            limits[joints + k] = space->start[space->columns[k]] + M_PI;
        }
    double reach[2] = {distance_between(limits, limits + joints, joints) * LONGEST_SHARE, INFINITY};
    if (status == LOEWNER_OK)
        status =
            grow(&trees, joints, TREE_CAPACITY > 2 * (int64_t)goal_count ? TREE_CAPACITY : 2 * (int64_t)goal_count);
    if (status == LOEWNER_OK) {
        int64_t capacity = trees.capacity;
        for (int64_t k = 0; k < joints; k++) {
            trees.nodes[k * capacity] = space->start[space->columns[k]];
            for (size_t g = 0; g < goal_count; g++)
                trees.nodes[(joints + k) * capacity + (int64_t)g] =
                    goals[g * (size_t)space->dof + (size_t)space->columns[k]];
        }
        trees.parents[0] = -1;
        trees.domains[0] = INFINITY;
        for (size_t g = 0; g < goal_count; g++) {
            trees.parents[capacity + (int64_t)g] = -1;
            trees.domains[capacity + (int64_t)g] = INFINITY;
        }
        state[STARTS] = 1;
        state[GOALS] = (int64_t)goal_count;
        state[RANDOM] = seed;
    }
    double began = seconds();
    while (status == LOEWNER_OK && outcome != CODE_MET) {
        int64_t done = state[ITERATION], most = done + portion < max_iterations ? done + portion : max_iterations;
        double called = seconds();
        if (done == max_iterations || (done > 0 && called - began > timeout)) {
            status = fail(LOEWNER_NO_PATH,
                          "expected a path from start to goal, found none within %lld iterations and %.3g s",
                          (long long)done, called - began);
            break;
        }
        status = grow_on(judge, space, &trees, reach, state, &gap, ends, points, most, &outcome);
        portion = seconds() - called >= A_WHILE   ? (portion / 2 > 1 ? portion / 2 : 1)
                  : 2 * portion < MOST_ITERATIONS ? 2 * portion
                                                  : MOST_ITERATIONS;
    }
    if (status == LOEWNER_OK)
        status = write_path(judge, space, &trees, state, count);
    leave_trees(&trees);
    free(ends);
    free(points);
    return status;
}

/* Shorten the path in the workspace, whose motions are all free. */
static loewner_status cut_corners(const Judge *judge, int64_t *count, int64_t cuts, uint32_t seed)
{
    loewner_workspace *workspace = judge->workspace;
    int64_t dof = judge->checker->file->dof, state[STATE] = {0}, done = -1,
            room = *count + (cuts < MOST_ROOM ? cuts : MOST_ROOM);
    TRY(make_room(workspace, room, dof));
    state[RANDOM] = seed;
    while (done < cuts && *count > 2 && done != state[ITERATION]) {
        done = state[ITERATION];
        TRY(CALL(shorten_path, count, .count = *count,
                 .most = done + MOST_ITERATIONS < cuts ? done + MOST_ITERATIONS : cuts,
                 .handles = {judge->handles, 7}, .lengths = {judge->lengths, 2}, .path = {workspace->path, room, dof},
                 .state = {state, STATE}, .ends = {workspace->courses, 2, dof},
                 .points = {workspace->courses + 2 * dof, 2, dof}));
    }
    return LOEWNER_OK;
}

/* -- what programs call -------------------------------------------------------------------------------------------- */

static loewner_status check_plan_options(const loewner_checker *checker, const loewner_plan_options *options)
{
    if (options->max_iterations < 0 || !(options->timeout >= 0) || options->cuts < -1)
        return fail(LOEWNER_BAD_ARGUMENT,
                    "options: expected iterations, a time and cuts that are not negative, found others");
    for (int64_t c = 0; options->joint_error != NULL && c < checker->file->dof; c++)
        if (!(options->joint_error[c] >= 0 && options->joint_error[c] < INFINITY))
            return fail(LOEWNER_BAD_ARGUMENT, "joint_error: expected numbers >= 0, found %g", options->joint_error[c]);
    return LOEWNER_OK;
}

/* Keep the goals that are inside the limits and free, in `good`. */
static loewner_status choose_goals(const Judge *judge, const Space *space, const double *goals, size_t goal_count,
                                   double *good, size_t *count)
{
    size_t dof = (size_t)space->dof;
    int is = is_inside(space, space->start), inside = 0;
    if (!is)
        return fail(LOEWNER_NOT_FREE, "start: expected values within the limits, found others");
    TRY(is_free_at(judge, space->start, &is));
    if (!is)
        return fail(LOEWNER_NOT_FREE,
                    "start: expected a free configuration, found one that collides, or is not proven free");
    *count = 0;
    for (size_t g = 0; g < goal_count; g++) {
        const double *goal = goals + g * dof;
        if (!is_inside(space, goal))
            continue;
        inside++;
        int64_t moved = 0;
        for (size_t c = 0; c < dof; c++) {
            while (moved < space->count && space->columns[moved] < (int64_t)c)
                moved++;
            if (!(moved < space->count && space->columns[moved] == (int64_t)c) && goal[c] != space->start[c])
                return fail(LOEWNER_BAD_ARGUMENT,
                            "goals: expected the start's value of %s, which does not move, found another",
                            loewner_checker_value_name(judge->checker, (int32_t)c));
        }
        TRY(is_free_at(judge, goal, &is));
        if (is)
            memcpy(good + (*count)++ * dof, goal, dof * sizeof *good);
    }
    return *count > 0 ? LOEWNER_OK
                      : fail(LOEWNER_NOT_FREE,
                             "goals: expected a free configuration within the limits, found %d within them, "
                             "none of them proven free",
                             inside);
}

loewner_status loewner_checker_plan(const loewner_checker *checker, loewner_workspace *workspace, const double *start,
                                    const double *goals, size_t goal_count, const loewner_plan_options *options,
                                    const double **path, size_t *count)
{
    static const loewner_plan_options usual;
    options = options == NULL ? &usual : options;
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    if (path == NULL || count == NULL || goal_count == 0)
        return fail(
            LOEWNER_BAD_ARGUMENT,
            "goals, path, count: expected one goal or more, and places for the path and its length, found none");
    TRY(check_configurations(checker, start, 1, "start"));
    TRY(check_configurations(checker, goals, goal_count, "goals"));
    TRY(check_plan_options(checker, options));
    Judge judge = judge_of(checker, workspace, options->joint_error);
    Space space;
    size_t dof = (size_t)checker->file->dof, good_count = 0;
    int64_t rows = 0;
    double *good = malloc((goal_count + 1) * dof * sizeof *good);
    loewner_status outcome = good == NULL ? no_memory() : LOEWNER_OK;
    space.columns = NULL;
    space.limits = NULL;
    if (outcome == LOEWNER_OK) {
        memcpy(good + goal_count * dof, start, dof * sizeof *good); /* the caller's may lie in the workspace */
        outcome = space_of(checker, good + goal_count * dof, goals, goal_count, options->joints, options->seed, &space);
    }
    if (outcome == LOEWNER_OK)
        outcome = choose_goals(&judge, &space, goals, goal_count, good, &good_count);
    if (outcome == LOEWNER_OK)
        outcome = connect(&judge, &space, good, good_count, options->seed,
                          options->max_iterations > 0 ? options->max_iterations : USUAL_ITERATIONS,
                          options->timeout > 0 ? options->timeout : 10, &rows);
    if (outcome == LOEWNER_OK && options->cuts >= 0)
        outcome = cut_corners(&judge, &rows, options->cuts > 0 ? options->cuts : USUAL_CUTS, options->seed);
    free(space.columns);
    free(space.limits);
    free(good);
    *path = outcome == LOEWNER_OK ? workspace->path : NULL;
    *count = outcome == LOEWNER_OK ? (size_t)rows : 0;
    return outcome;
}

loewner_status loewner_checker_shorten(const loewner_checker *checker, loewner_workspace *workspace, const double *path,
                                       size_t n, const loewner_plan_options *options, const double **shorter,
                                       size_t *count)
{
    static const loewner_plan_options usual;
    options = options == NULL ? &usual : options;
    HOLD(workspace);
    TRY(prepare_exact(checker, workspace));
    if (shorter == NULL || count == NULL || n < 2)
        return fail(LOEWNER_BAD_ARGUMENT, "expected two or more configurations and places for the path, found fewer");
    TRY(check_configurations(checker, path, n, "path"));
    TRY(check_plan_options(checker, options));
    size_t dof = (size_t)checker->file->dof;
    Judge judge = judge_of(checker, workspace, options->joint_error);
    int64_t at, rows = (int64_t)n;
    TRY(is_free(&judge, path, rows, &at));
    if (at >= 0)
        return fail(LOEWNER_NOT_FREE,
                    "path: expected free motions, found the one from row %lld, which is not proven free",
                    (long long)at);
    /* The path may lie in the workspace, which may move while it grows. */
    int is_own = workspace->path != NULL && path >= workspace->path && path < workspace->path + workspace->path_room;
    ptrdiff_t begin = is_own ? path - workspace->path : 0;
    TRY(make_room(workspace, (is_own ? (int64_t)begin / (int64_t)dof + 1 : 0) + rows, (int64_t)dof));
    memmove(workspace->path, is_own ? workspace->path + begin : path, n * dof * sizeof *path);
    if (options->cuts >= 0)
        TRY(cut_corners(&judge, &rows, options->cuts > 0 ? options->cuts : USUAL_CUTS, options->seed));
    *shorter = workspace->path;
    *count = (size_t)rows;
    return LOEWNER_OK;
}
