/* This file plans paths in the same steps as `loewner/planners/compiled.py`, so equal seeds give equal paths in C and
   in Python. Both languages call the same kernels for the search. */

#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* The checker, and the options for planning a path and for proving that its motions are free. */
typedef struct {
    const loewner_checker *checker;
    loewner_workspace *workspace;
    loewner_plan_options plan;
    loewner_proof_options options;
    int64_t handles[7];
    double lengths[2];
} Judge;

/* A search for a path: the arrays that the kernels use, and the memory for these arrays. */
typedef struct {
    struct search arrays;
    /* `dof`: number of values of a configuration; `joints`: number of values that the search changes. */
    int64_t dof, joints, state[STATE];
    int64_t *columns, *turning;
    double reach[3], *lower, *upper, *start, *goals; /* `goals`: the free goals, `goal_count` of them. */
    size_t goal_count;
} Search;

static void leave_search(Search *search)
{
    free(search->columns); /* The block of memory at `columns` holds all arrays except the trees. */
    free((void *)search->arrays.trees.data);
}

/* Try to prove that n motions are free. Write to `at` the index of the first motion that is not proven free, or -1. */
static loewner_status are_free(const Judge *judge, const double *starts, const double *ends, size_t n, int64_t *at)
{
    loewner_workspace *workspace = judge->workspace;
    *at = -1;
    for (size_t first = 0; first < n && *at < 0; first += MOTIONS_AT_ONCE) {
        size_t count = write_courses(workspace, starts, ends, first, n);
        TRY(prove(workspace, 0, count, 1, &judge->options, workspace->found));
        for (size_t k = 0; k < count && *at < 0; k++)
            if (workspace->found[k] != LOEWNER_FREE)
                *at = (int64_t)(first + k);
    }
    return LOEWNER_OK;
}

/* Find out whether one configuration is proven free for all deviations within the joint error. */
static loewner_status is_free_at(const Judge *judge, const double *q, int *is)
{
    int8_t verdict;
    int64_t at = -1;
    TRY(collide(judge->workspace, CODE_EXACT, q, 1, &verdict));
    if (verdict == LOEWNER_FREE && judge->options.joint_error != NULL)
        TRY(are_free(judge, q, q, 1, &at)); /* Prove that a motion that stays at this configuration is free. */
    *is = verdict == LOEWNER_FREE && at < 0;
    return LOEWNER_OK;
}

/* -- searches ------------------------------------------------------------------------------------------------------ */

/* Choose the values that the search changes, and their ranges. The trees get no memory yet. */
static loewner_status make_search(const Judge *judge, const double *start, const double *goals, size_t goal_count,
                                  Search *search)
{
    const uint8_t *joints = judge->plan.joints;
    const File *file = judge->checker->file;
    int64_t dof = search->dof = file->dof, count = 0;
    double *block;
    TRY(allocate(&block, sizeof(double) * (8 + goal_count) * (size_t)dof));
    search->columns = (int64_t *)block;
    search->turning = (int64_t *)block + dof;
    search->lower = block + 2 * dof;
    search->upper = block + 3 * dof;
    double *weights = block + 4 * dof;
    /* Copy the start, because it may lie in the workspace, whose memory changes. */
    search->start = memcpy(block + 7 * dof, start, sizeof(double) * (size_t)dof);
    search->goals = block + 8 * dof;
    for (int64_t c = 0; c < dof; c++) {
        if (joints != NULL && !joints[c])
            continue;
        REQUIRE(file->joints[c] & JOINT_SINGLE,
                "joints: expected joints of one value each, found %s, which has no limits to search within; name the "
                "joints that are to move", loewner_checker_value_name(judge->checker, (int32_t)c));
        double least = start[c], most = start[c], lower = file->limits[c], upper = file->limits[dof + c];
        for (size_t g = 0; g < goal_count; g++) {
            least = fmin(least, goals[g * (size_t)dof + (size_t)c]);
            most = fmax(most, goals[g * (size_t)dof + (size_t)c]);
        }
        lower = file->joints[c] & JOINT_NO_LOWER ? fmax(least - M_PI, lower) : lower;
        upper = file->joints[c] & JOINT_NO_UPPER ? fmin(most + M_PI, upper) : upper;
        if (!(lower < upper))
            continue;
        search->columns[count] = c;
        search->turning[count] = (file->joints[c] & JOINT_TURNING) != 0;
        search->lower[count] = lower;
        search->upper[count] = upper;
        weights[count++] = 1;
    }
    search->joints = count;
    search->arrays = (struct search){
        .handles = {judge->handles, 7, 1}, .lengths = {judge->lengths, 2, 1}, .columns = {search->columns, count, 1},
        .turning = {search->turning, count, 1}, .lower = {search->lower, count, 1}, .upper = {search->upper, count, 1},
        .weights = {weights, count, 1}, .stride = {block + 5 * dof, count, 1}, .shift = {block + 6 * dof, count, 1},
        .reach = {search->reach, 3, 1}, .state = {search->state, STATE, 1}, .start = {search->start, dof, 1},
    };
    return count > 0 ? LOEWNER_OK
                     : fail(LOEWNER_BAD_ARGUMENT, "joints: expected one or more that can move, found none");
}

/* Return the first of the search's joints whose value is outside the limits, or -1. */
static int64_t outside(const Search *search, const double *q)
{
    for (int64_t k = 0; k < search->joints; k++) {
        double value = q[search->columns[k]];
        if (!(value >= search->lower[k] - ON_LIMIT && value <= search->upper[k] + ON_LIMIT))
            return k;
    }
    return -1;
}

/* Report why a configuration, which messages call `name`, cannot be on a path. */
static loewner_status refuse(const Judge *judge, const Search *search, const double *q, const char *name)
{
    const loewner_checker *checker = judge->checker;
    int64_t k = outside(search, q), pair;
    int32_t bodies[2];
    int8_t verdict;
    if (k >= 0)
        return fail(LOEWNER_NOT_FREE, "%s: expected values within the limits, found %.100s = %g outside %g .. %g", name,
                    loewner_checker_value_name(checker, (int32_t)search->columns[k]), q[search->columns[k]],
                    search->lower[k], search->upper[k]);
    TRY(worst_pair(judge->workspace, q, &verdict, &pair));
    if (pair < 0)
        return fail(LOEWNER_NOT_FREE, "%s: expected a free configuration, found one that is not proven free%s", name,
                    judge->options.joint_error != NULL ? " with the joint_error" : "");
    write_bodies(&checker->state, pair, bodies);
    return fail(LOEWNER_NOT_FREE, "%s: expected a free configuration, found %s %.100s and %.100s", name,
                verdict == LOEWNER_COLLIDING ? "a collision of" : "no proof for",
                loewner_checker_body_name(checker, bodies[0]), loewner_checker_body_name(checker, bodies[1]));
}

/* Allocate more memory for the trees, and copy their rows to it. */
static loewner_status grow(Search *search, int64_t capacity)
{
    Array2 old = search->arrays.trees, more = {NULL, 2 * search->joints + TREE_ROWS, capacity};
    TRY(allocate(&more.data, sizeof(double) * (size_t)(more.rows * capacity)));
    for (int64_t row = 0; row < old.rows; row++)
        memcpy((double *)more.data + row * capacity, (const double *)old.data + row * old.columns,
               sizeof(double) * (size_t)old.columns);
    free((void *)old.data);
    search->arrays.trees = more;
    return LOEWNER_OK;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Enlarge the workspace's memory for a path if it is too small. */
static loewner_status make_room(loewner_workspace *workspace, int64_t rows, int64_t dof)
{
    size_t needed = (size_t)(rows * dof);
    if (workspace->path_room < needed) {
        TRY(enlarge(&workspace->path, needed * sizeof(double)));
        workspace->path_room = needed;
    }
    return LOEWNER_OK;
}

/* Extend the trees until they meet, and write the path that connects them to the workspace. */
static loewner_status connect(const Judge *judge, Search *search, int64_t *count)
{
    const loewner_plan_options *options = &judge->plan;
    int64_t handle = (int64_t)&search->arrays, portion = FIRST_ITERATIONS, outcome = CODE_FULL, at = -1, turned;
    int64_t limit = options->max_iterations > 0 ? options->max_iterations : USUAL_ITERATIONS;
    int64_t goals = (int64_t)search->goal_count, dof = search->dof;
    TRY(grow(search, 2 * goals > TREE_CAPACITY ? 2 * goals : TREE_CAPACITY));
    TRY(CALL(begin_search, NULL, .search = handle, .goals = {search->goals, goals, dof}, .seed = options->seed));
    for (double began = seconds(); outcome != CODE_MET;) {
        int64_t done = search->state[ITERATION], most = done + portion < limit ? done + portion : limit;
        double called = seconds();
        if (done == limit || (done > 0 && called - began > (options->timeout > 0 ? options->timeout : 10)))
            return fail(LOEWNER_NO_PATH,
                        "expected a path from start to goal, found none within %lld iterations and %.3g s",
                        (long long)done, called - began);
        TRY(CALL(connect_trees, &outcome, .search = handle, .most = most));
        if (outcome == CODE_FULL)
            TRY(grow(search, 2 * search->arrays.trees.columns));
        portion = seconds() - called >= A_WHILE   ? (portion / 2 > 1 ? portion / 2 : 1)
                  : 2 * portion < MOST_ITERATIONS ? 2 * portion
                                                  : MOST_ITERATIONS;
    }
    *count = search->state[ROWS];
    TRY(make_room(judge->workspace, *count, dof));
    TRY(CALL(path_through, &turned, .search = handle, .path = {judge->workspace->path, *count, dof}));
    const double *path = judge->workspace->path;
    if (turned || judge->checker->state.starts_matter)
        TRY(are_free(judge, path, path + dof, (size_t)*count - 1, &at));
    return at < 0 ? LOEWNER_OK
                  : fail(LOEWNER_NO_PATH, "expected a path that is free as a whole; another seed may help");
}

/* Shorten the path that `judge->workspace` holds. All motions of the path must be free. If the options set a negative
   number of cuts, leave the path unchanged. */
static loewner_status cut_corners(const Judge *judge, int64_t *count)
{
    const loewner_plan_options *options = &judge->plan;
    loewner_workspace *workspace = judge->workspace;
    int64_t cuts = options->cuts == 0 ? USUAL_CUTS : options->cuts, dof = judge->checker->file->dof, done = -1;
    int64_t state[STATE] = {[RANDOM] = options->seed}, room = *count + (cuts < MOST_ROOM ? cuts : MOST_ROOM);
    if (cuts < 0)
        return LOEWNER_OK;
    TRY(make_room(workspace, room, dof));
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

/* -- interface ----------------------------------------------------------------------------------------------------- */

/* Check the options, and make the judge that they describe. */
static loewner_status take_judge(const loewner_checker *checker, loewner_workspace *workspace,
                                 const loewner_plan_options *options, Judge *judge)
{
    const loewner_plan_options plan = options == NULL ? (loewner_plan_options){0} : *options;
    const double *joint_error = plan.joint_error;
    REQUIRE(plan.max_iterations >= 0 && plan.timeout >= 0 && plan.cuts >= -1,
            "options: expected iterations, a time and cuts that are not negative, found others");
    TRY(take_errors(checker, &joint_error));
    const Half *half = half_of(checker, CUT);
    *judge = (Judge){
        checker,
        workspace,
        plan,
        {.tolerance = PLAN_TOLERANCE, .joint_error = joint_error, .steps = CODE_NO_LIMIT},
        {(int64_t)&half->pieces, half->handle, half->motions, (int64_t)workspace->memory, 1, (int64_t)joint_error, 0},
        {PLAN_TOLERANCE, 0},
    };
    return LOEWNER_OK;
}

/* Check the start, and keep the goals that are free and within the limits. */
static loewner_status choose_goals(const Judge *judge, Search *search, const double *goals, size_t goal_count)
{
    size_t dof = (size_t)search->dof;
    /* The goal that messages name: the first one within the limits, or goals[0] if there is none. */
    size_t named = goal_count;
    int is = outside(search, search->start) < 0;
    if (is)
        TRY(is_free_at(judge, search->start, &is));
    if (!is)
        return refuse(judge, search, search->start, "start");
    for (size_t g = 0; g < goal_count; g++) {
        const double *goal = goals + g * dof;
        if (outside(search, goal) >= 0)
            continue;
        named = g < named ? g : named;
        int64_t moved = 0;
        for (size_t c = 0; c < dof; c++) {
            while (moved < search->joints && search->columns[moved] < (int64_t)c)
                moved++;
            REQUIRE((moved < search->joints && search->columns[moved] == (int64_t)c) || goal[c] == search->start[c],
                    "goals: expected the start's value of %s, which does not move, found another",
                    loewner_checker_value_name(judge->checker, (int32_t)c));
        }
        TRY(is_free_at(judge, goal, &is));
        if (is)
            memcpy(search->goals + search->goal_count++ * dof, goal, dof * sizeof *goal);
    }
    if (search->goal_count > 0)
        return LOEWNER_OK;
    char name[80];
    named = named < goal_count ? named : 0;
    snprintf(name, sizeof name, goal_count > 1 ? "goals[%zu], no other being free" : "goals[%zu]", named);
    return refuse(judge, search, goals + named * dof, name);
}

loewner_status loewner_checker_plan(const loewner_checker *checker, loewner_workspace *workspace, const double *start,
                                    const double *goals, size_t goal_count, const loewner_plan_options *options,
                                    const double **path, size_t *count)
{
    HOLD_PREPARED(checker, workspace, prepare_exact);
    REQUIRE(path != NULL && count != NULL && goal_count > 0,
            "goals, path, count: expected one goal or more, and places for the path and its length, found none");
    *path = NULL;
    *count = 0;
    TRY(check_configurations(checker, start, 1, "start"));
    TRY(check_configurations(checker, goals, goal_count, "goals"));
    Judge judge;
    TRY(take_judge(checker, workspace, options, &judge));
    Search search __attribute__((cleanup(leave_search))) = {0};
    int64_t rows;
    TRY(make_search(&judge, start, goals, goal_count, &search));
    TRY(choose_goals(&judge, &search, goals, goal_count));
    TRY(connect(&judge, &search, &rows));
    TRY(cut_corners(&judge, &rows));
    *path = workspace->path;
    *count = (size_t)rows;
    return LOEWNER_OK;
}

loewner_status loewner_checker_shorten(const loewner_checker *checker, loewner_workspace *workspace, const double *path,
                                       size_t n, const loewner_plan_options *options, const double **shorter,
                                       size_t *count)
{
    HOLD_PREPARED(checker, workspace, prepare_exact);
    REQUIRE(shorter != NULL && count != NULL && n >= 2,
            "expected two or more configurations and places for the path, found fewer");
    TRY(check_configurations(checker, path, n, "path"));
    size_t dof = (size_t)checker->file->dof;
    Judge judge;
    int64_t at, rows = (int64_t)n;
    TRY(take_judge(checker, workspace, options, &judge));
    TRY(are_free(&judge, path, path + dof, n - 1, &at));
    if (at >= 0)
        return fail(LOEWNER_NOT_FREE,
                    "path: expected free motions, found the one from row %lld, which is not proven free",
                    (long long)at);
    /* The given path may lie in the workspace's memory, which may move when it is enlarged. */
    int is_own = workspace->path != NULL && path >= workspace->path && path < workspace->path + workspace->path_room;
    ptrdiff_t begin = is_own ? path - workspace->path : 0;
    TRY(make_room(workspace, (is_own ? (int64_t)begin / (int64_t)dof + 1 : 0) + rows, (int64_t)dof));
    memmove(workspace->path, is_own ? workspace->path + begin : path, n * dof * sizeof *path);
    TRY(cut_corners(&judge, &rows));
    *shorter = workspace->path;
    *count = (size_t)rows;
    return LOEWNER_OK;
}
