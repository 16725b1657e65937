/* The bodies of a checker, their poses, and the pairs to check, in the form that kernels take. Like the Python package,
   this file calls the kernels of `loewner/_kernels/robots/pair_lists.py` and `loewner/_kernels/pieces/joining.py`. */

#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static _Atomic uint64_t serials = 1;

/* -- memory of a state --------------------------------------------------------------------------------------------- */

/* Allocate memory that lives as long as the state, and write its address to `field`. */
static loewner_status room(State *state, void *field, int64_t count, size_t size)
{
    void *made = aligned_alloc(CACHE_LINE, in_lines((size_t)count * size + 1)); /* Allocate at least one cache line. */
    if (made == NULL || state->memory_count == (int)(sizeof state->memory / sizeof *state->memory)) {
        free(made);
        return no_memory();
    }
    memcpy(field, &made, sizeof made);
    state->memory[state->memory_count++] = made;
    return LOEWNER_OK;
}

static void leave_state(State *state)
{
    for (int k = 0; k < state->memory_count; k++)
        free(state->memory[k]);
    memset(state, 0, sizeof *state);
}

/* -- packs of chosen bodies ---------------------------------------------------------------------------------------- */

/* Return a link that moves rigidly with the given link: the parent of the given link (-1 for the world) if the joint
   between them is fixed, and otherwise the given link itself. */
static int64_t rigid_link(const Tree *tree, int64_t link)
{
    return tree->kind[link] == FIXED ? tree->parent[link] : link;
}

/* Return whether the body at position k never moves. */
static int stands(const State *state, int64_t k)
{
    return k >= state->moving || rigid_link(&state->tree, state->link[k]) == rigid_link(&state->tree, 0);
}

/* Return the pack from which the body at position k is taken. */
static const struct pieces *pack_of(const State *state, const Body *body, int64_t k, Cutting cutting)
{
    int is_whole = !body->file->has_cut || (cutting == OPEN_CUT && !stands(state, k));
    return body->file->packs + (is_whole ? WHOLE : cutting);
}

/* Join all bodies of a state in one pack. */
static loewner_status join(const loewner_checker *checker, State *state, Cutting cutting, Half *half)
{
    int64_t bodies = state->moving + state->standing, *chosen, words;
    TRY(room(state, &chosen, 2 * bodies, 8));
    for (int64_t k = 0; k < bodies; k++) {
        const Body *body = checker->bodies + state->body[k];
        chosen[2 * k] = (int64_t)pack_of(state, body, k, cutting);
        chosen[2 * k + 1] = body->which;
    }
    struct join_bodies asked = {.chosen = {chosen, bodies, 2}};
    TRY(call(kernels()->join_bodies, &asked, &words));
    asked.block.length = words;
    TRY(room(state, &asked.block.data, words, 8));
    TRY(call(kernels()->join_bodies, &asked, &words));
    memcpy(&half->pieces, asked.block.data, sizeof half->pieces);
    return LOEWNER_OK;
}

/* -- links --------------------------------------------------------------------------------------------------------- */

/* Multiply the constant pose of a link by another pose, and write the product to the constants of a new link. */
static void place_link(const double *constants, const double *pose, double *made)
{
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 4; c++) {
            double entry = c == 3 ? constants[TRANSLATION + r] : 0;
            for (int m = 0; m < 3; m++)
                entry += constants[3 * r + m] * pose[4 * m + c];
            made[c == 3 ? TRANSLATION + r : 3 * r + c] = entry;
        }
}

/* Build the tree of links: the robot's links, followed by one link with a fixed joint for each attached body. */
static loewner_status grow_tree(const loewner_checker *checker, State *state)
{
    static const double at_link[LINK_CONSTANTS] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const Tree *given = &checker->file->tree;
    const void *const from[] = {given->parent,     given->kind,   given->column,
                                given->multiplier, given->offset, given->constants};
    void *arrays[6];
    int64_t links = given->links;
    for (int k = 0; k < 6; k++) {
        size_t size = k < 5 ? 8 : 8 * LINK_CONSTANTS;
        TRY(room(state, arrays + k, links + state->attached, size));
        memset(arrays[k], 0, (size_t)(links + state->attached) * size);
        memcpy(arrays[k], from[k], (size_t)links * size);
    }
    int64_t *parent = arrays[0], *kind = arrays[1];
    double *multiplier = arrays[3], *constants = arrays[5];
    for (int64_t k = state->moving - state->attached; k < state->moving; k++) {
        const Body *body = checker->bodies + state->body[k];
        int is_fixed = kind[body->link] == FIXED;
        parent[links] = rigid_link(given, body->link);
        kind[links] = FIXED;
        multiplier[links] = 1;
        place_link(is_fixed ? constants + LINK_CONSTANTS * body->link : at_link, body->pose,
                   constants + LINK_CONSTANTS * links);
        state->link[k] = links++;
    }
    state->tree = (Tree){links, parent, kind, arrays[2], multiplier, arrays[4], constants};
    return LOEWNER_OK;
}

/* -- pairs --------------------------------------------------------------------------------------------------------- */

/* Return the index of the row that begins with the bodies a and b, where a < b, or -1 if the table has no such row. */
static int64_t row_of(const int64_t *rows, int64_t count, int64_t width, int64_t a, int64_t b)
{
    for (int64_t k = 0; k < count; k++)
        if (rows[width * k] == a && rows[width * k + 1] == b)
            return k;
    return -1;
}

/* Return whether the bodies and their pairs are exactly as in the file, and all bodies are present. */
static int is_as_saved(const loewner_checker *checker)
{
    int is = checker->body_count == checker->file->bodies && checker->rule_count == 0;
    for (int32_t b = 0; is && b < checker->body_count; b++)
        is = checker->bodies[b].is_present && !checker->bodies[b].is_attached;
    return is;
}

enum { RULE = 4 };

/* Rules for pairs, in the form that `list_pairs` takes. */
typedef struct {
    int64_t *rows, count;
    double *margins;
} Rules;

/* Append a rule for two bodies. `touch` is -1 if the rule sets only a margin; `margin` is -1 if the rule sets none. */
static void add_rule(const State *state, Rules *rules, int64_t a, int64_t b, int64_t touch, double margin)
{
    const int64_t row[RULE] = {state->place[a], state->place[b], touch, 1};
    memcpy(rules->rows + RULE * rules->count, row, sizeof row);
    rules->margins[rules->count++] = margin;
}

/* List the rules from the file and from the user, and the rules for attached bodies: an attached body may touch the
   robot's own bodies on its touch links. */
static void list_rules(const loewner_checker *checker, const State *state, Rules *rules)
{
    const File *file = checker->file;
    int64_t at = 0;
    /* Among the pairs in the file that contain a moving body, only the listed pairs have to be checked; the bodies of
       all other pairs may touch. */
    for (int64_t a = 0; a < file->moving; a++)
        for (int64_t b = a + 1; b < file->bodies; b++) {
            const int64_t *pair = file->pair_list + 2 * at;
            int is_listed = at < file->pairs && pair[0] == a && pair[1] == b;
            add_rule(state, rules, a, b, !is_listed, is_listed ? file->margins[at] : -1);
            at += is_listed;
        }
    for (int64_t k = 0; k < file->rule_count; k++) {
        const int64_t *rule = file->rules + 3 * k;
        add_rule(state, rules, rule[0], rule[1], rule[2], file->rule_margins[k]);
    }
    for (const Rule *its = checker->rules; its < checker->rules + checker->rule_count; its++)
        add_rule(state, rules, its->a, its->b, its->touch, its->margin);
    for (int32_t b = 0; b < checker->body_count; b++)
        for (size_t k = 0; k < checker->bodies[b].touch_count; k++) {
            int32_t link = checker->bodies[b].touch[k];
            int32_t other = loewner_checker_find_body(checker, loewner_checker_link_name(checker, link));
            if (other >= 0 && checker->bodies[other].link == link && !checker->bodies[other].is_attached)
                add_rule(state, rules, b, other, 1, -1);
        }
}

/* Choose the pairs to check among all pairs with a moving body; `most` is the number of all such pairs. */
static loewner_status choose_pairs(const loewner_checker *checker, State *state, int64_t most)
{
    const File *file = checker->file;
    int64_t bodies = state->moving + state->standing, count = file->moving * file->bodies + file->rule_count;
    count += (int64_t)checker->rule_count;
    for (int32_t b = 0; b < checker->body_count; b++)
        count += (int64_t)checker->bodies[b].touch_count;
    double *own;
    TRY(room(state, &own, 5 * bodies + (RULE + 1) * count, 8));
    memset(own, 0, (size_t)bodies * 5 * 8);
    int64_t *marks = (int64_t *)(own + 2 * bodies);
    Rules rules = {marks + 3 * bodies, 0, (double *)(marks + 3 * bodies + RULE * count)};
    for (int64_t k = 0; k < bodies; k++)
        if (state->body[k] < file->bodies) {
            own[2 * k] = file->own[state->body[k]];
            marks[3 * k + 1] = file->lowered[state->body[k]];
        }
    list_rules(checker, state, &rules);
    const Tree *tree = &state->tree;
    return CALL(
        list_pairs, &state->pairs, .parent = {tree->parent, tree->links}, .kind = {tree->kind, tree->links},
        .link = {state->link, state->moving}, .marks = {marks, bodies, 3}, .own = {own, bodies, 2},
        .least = {&file->margin, 1}, .rules = {rules.rows, rules.count, RULE},
        .rule_margins = {rules.margins, rules.count}, .pairs = {state->pair_list, most, 2},
        .margins = {state->margins, most});
}

static loewner_status list_pairs(const loewner_checker *checker, State *state)
{
    const File *file = checker->file;
    int64_t most = state->is_as_saved ? file->pairs : state->moving * (state->moving + 2 * state->standing - 1) / 2;
    TRY(room(state, &state->pair_list, 2 * most, 8));
    TRY(room(state, &state->margins, most, 8));
    TRY(room(state, &state->order, most, 8));
    TRY(room(state, &state->rows, 2 * most, 8));
    state->pairs = most;
    if (state->is_as_saved) {
        memcpy(state->pair_list, file->pair_list, (size_t)most * 16);
        memcpy(state->margins, file->margins, (size_t)most * 8);
    } else
        TRY(choose_pairs(checker, state, most));
    for (int64_t k = 0; k < state->pairs; k++) {
        state->order[k] = state->is_as_saved ? file->order[k] : k;
        state->rows[k] = state->pair_list[2 * k];
        state->rows[state->pairs + k] = state->pair_list[2 * k + 1];
    }
    return LOEWNER_OK;
}

/* -- halves -------------------------------------------------------------------------------------------------------- */

/* Place the static bodies whose poses have changed, and overwrite the previous results in the same memory. No other
   thread may query this checker in the meantime. */
static loewner_status place(const State *state, Half *half)
{
    return CALL(place_static, &half->handle, .pack = (int64_t)&half->pieces, .handle = half->handle,
                .block = {half->block, half->block_words}, .poses = {state->poses, state->standing, 16});
}

static loewner_status make_half(const loewner_checker *checker, State *state, Cutting cutting)
{
    Half *half = state->halves + cutting;
    const Tree *tree = &state->tree;
    int64_t links = tree->links, pairs = state->pairs;
    if (state->is_as_saved)
        half->pieces = checker->file->packs[cutting];
    else
        TRY(join(checker, state, cutting, half));
    const int64_t *layout = half->pieces.layout.data;
    for (int64_t p = 0; p < half->pieces.layout.rows; p++)
        state->starts_matter |= layout[LAYOUT * p + KIND_OF] == SOLID;
    const struct problem given = {
        .parent = {tree->parent, links, 1}, .kind = {tree->kind, links, 1}, .column = {tree->column, links, 1},
        .multiplier = {tree->multiplier, links, 1}, .offset = {tree->offset, links, 1},
        .constants = {tree->constants, links, LINK_CONSTANTS}, .link = {state->link, state->moving, 1},
        .pairs = {state->pair_list, pairs, 2}, .margins = {state->margins, pairs, 1},
        .order = {state->order, pairs, 1},
    };
    struct lay_out asked = {.pack = (int64_t)&half->pieces, .handle = (int64_t)&given};
    struct lay_out_results made;
    TRY(call(kernels()->lay_out, &asked, &made));
    asked.lasting.length = made.lasting_words;
    asked.block.length = half->block_words = made.block_words;
    TRY(room(state, &asked.lasting.data, made.lasting_words, 8));
    TRY(room(state, &half->block, made.block_words, 8));
    asked.block.data = half->block;
    TRY(call(kernels()->lay_out, &asked, &made));
    half->handle = made.made;
    half->motions = half->handle + (int64_t)offsetof(Tables, motions);
    TRY(place(state, half));
    /* Compute how much memory the largest query needs. The last size is for proofs of motions, which use the surfaces
       that are cut into parts. */
    const Kernels *known = kernels();
    const struct memory_size sized = {(int64_t)&half->pieces, half->handle, checker->file->dof};
    const Kernel sizes[] = {known->memory_size, known->memory_of_nearest, known->memory_of_clearances,
                            known->motion_memory};
    half->memory = known->settle_memory;
    for (int k = 0; k < 3 + (cutting == (state->has_cut ? CUT : WHOLE)); k++) {
        int64_t size = 0;
        TRY(call(sizes[k], &sized, &size));
        half->memory = size > half->memory ? size : half->memory;
    }
    return LOEWNER_OK;
}

/* -- states -------------------------------------------------------------------------------------------------------- */

/* Order the bodies: first the robot's own bodies, then the attached bodies, then the static bodies. */
static loewner_status arrange(const loewner_checker *checker, State *state)
{
    int32_t count = checker->body_count, at = 0;
    TRY(room(state, &state->body, count, sizeof *state->body));
    TRY(room(state, &state->place, count, sizeof *state->place));
    memset(state->place, -1, (size_t)count * sizeof *state->place);
    for (int group = 0; group < 3; group++)
        for (int32_t b = 0; b < count; b++) {
            const Body *body = checker->bodies + b;
            if (!body->is_present || (body->link < 0 ? 2 : body->is_attached) != group)
                continue;
            state->place[b] = at;
            state->body[at++] = b;
            state->moving += group < 2;
            state->attached += group == 1;
            state->growing += body->has_bounds;
            state->has_cut |= body->file->has_cut;
        }
    state->standing = at - state->moving;
    TRY(room(state, &state->link, state->moving, 8));
    TRY(room(state, &state->poses, 16 * state->standing, 8));
    for (int64_t k = 0; k < state->moving; k++)
        state->link[k] = checker->bodies[state->body[k]].link;
    return LOEWNER_OK;
}

static void copy_poses(const loewner_checker *checker, State *state)
{
    for (int64_t k = 0; k < state->standing; k++)
        memcpy(state->poses + 16 * k, checker->bodies[state->body[state->moving + k]].pose, 16 * sizeof(double));
}

static loewner_status assemble(const loewner_checker *checker, State *state)
{
    state->is_as_saved = is_as_saved(checker);
    TRY(arrange(checker, state));
    copy_poses(checker, state);
    TRY(grow_tree(checker, state));
    TRY(list_pairs(checker, state));
    for (int cutting = WHOLE; cutting < (state->has_cut ? CUTTINGS : CUT); cutting++)
        TRY(make_half(checker, state, cutting));
    return LOEWNER_OK;
}

/* Apply all pending changes; the caller must hold the checker's lock, unless no other thread can use the checker. */
static loewner_status renew(loewner_checker *checker)
{
    State *state = &checker->state;
    if (atomic_load(&checker->is_stale) == 2) {
        State made = {0};
        loewner_status outcome = assemble(checker, &made);
        if (outcome != LOEWNER_OK) {
            leave_state(&made);
            return outcome;
        }
        leave_state(state);
        *state = made;
        checker->serial = atomic_fetch_add(&serials, 1);
    } else { /* Workspaces remain valid, because all arrays stay where they are. */
        copy_poses(checker, state);
        for (Half *half = state->halves; half < state->halves + CUTTINGS; half++)
            if (half->block != NULL)
                TRY(place(state, half));
    }
    atomic_store(&checker->is_stale, 0);
    return LOEWNER_OK;
}

const Half *half_of(const loewner_checker *checker, Cutting cutting)
{
    const Half *half = checker->state.halves + cutting;
    return half->block != NULL ? half : checker->state.halves + WHOLE;
}

/* -- workspaces ---------------------------------------------------------------------------------------------------- */

loewner_status loewner_workspace_new(loewner_workspace **workspace)
{
    TRY(expect_pointer(workspace, 1, "workspace"));
    return allocate(workspace, sizeof **workspace);
}

void loewner_workspace_free(loewner_workspace *workspace)
{
    if (workspace == NULL)
        return;
    free(workspace->block);
    free(workspace->path);
    free(workspace);
}

size_t divide(void *block, const Part *parts, size_t count)
{
    size_t at = 0;
    for (size_t k = 0; k < count; k++) {
        if (block != NULL)
            *parts[k].field = (char *)block + at;
        at += in_lines(parts[k].size + CACHE_LINE);
    }
    return at;
}

loewner_status reserve(loewner_workspace *workspace, size_t size)
{
    workspace->serial = 0;
    if (workspace->size >= size)
        return LOEWNER_OK;
    free(workspace->block);
    workspace->size = 0;
    workspace->block = aligned_alloc(CACHE_LINE, in_lines(size));
    if (workspace->block == NULL)
        return no_memory();
    workspace->size = in_lines(size);
    return LOEWNER_OK;
}

static loewner_status bind(const loewner_checker *checker, loewner_workspace *workspace)
{
    const State *state = &checker->state;
    const Half *half = half_of(checker, CUT);
    size_t dof = (size_t)checker->file->dof, pairs = (size_t)state->pairs;
    size_t bodies = (size_t)(state->moving + state->standing);
    int64_t memory = 0;
    for (int k = 0; k < CUTTINGS; k++)
        memory = state->halves[k].memory > memory ? state->halves[k].memory : memory;
    const Part parts[] = {
        {(void **)&workspace->memory, (size_t)memory},
        {(void **)&workspace->validator, (size_t)half->memory},
        {(void **)&workspace->order, 8 * pairs},
        {(void **)&workspace->hits, 8 * pairs},
        {(void **)&workspace->link_poses, 128 * (size_t)state->tree.links},
        {(void **)&workspace->poses, 128 * bodies},
        {(void **)&workspace->courses, 8 * 8 * dof * MOTIONS_AT_ONCE},
        {(void **)&workspace->off, 8 * (dof + 3 * (size_t)state->growing) * MOTIONS_AT_ONCE},
        {(void **)&workspace->fractions, 8 * MOTIONS_AT_ONCE},
        {(void **)&workspace->numbers, 8 * 4 * MOTIONS_AT_ONCE},
        {(void **)&workspace->vectors, 8 * 9 * MOTIONS_AT_ONCE},
        {(void **)&workspace->slopes, 8 * dof * MOTIONS_AT_ONCE},
        {(void **)&workspace->found_pairs, 8 * MOTIONS_AT_ONCE},
        {(void **)&workspace->work, 8 * WORK * MOTIONS_AT_ONCE},
        {(void **)&workspace->pieces, 16 * MOTIONS_AT_ONCE},
        {(void **)&workspace->tiers, CHUNK},
        {(void **)&workspace->pair_verdicts, pairs},
        {(void **)&workspace->found, MOTIONS_AT_ONCE},
    };
    size_t count = sizeof parts / sizeof *parts;
    TRY(reserve(workspace, divide(NULL, parts, count)));
    divide(workspace->block, parts, count);
    /* Each workspace has its own order of pairs, because it learns which pairs collide most often. */
    memcpy(&workspace->tables, (const void *)state->halves[WHOLE].handle, sizeof workspace->tables);
    memcpy(workspace->order, state->order, 8 * pairs);
    memset(workspace->hits, 0, 8 * pairs);
    workspace->tables.problem.order.data = workspace->order;
    workspace->pack = (int64_t)&state->halves[WHOLE].pieces;
    workspace->seen = workspace->is_ready = 0;
    workspace->next_look = FIRST_LOOK;
    workspace->serial = checker->serial;
    return LOEWNER_OK;
}

/* Apply pending changes of the scene. If several threads query the checker, only one of them applies the changes. */
static loewner_status settle_scene(const loewner_checker *checker)
{
    TRY(expect_pointer(checker, 1, "checker"));
    if (!atomic_load_explicit(&checker->is_stale, memory_order_acquire))
        return LOEWNER_OK;
    loewner_checker *its = (loewner_checker *)checker;
    pthread_mutex_lock(&its->lock);
    loewner_status outcome = atomic_load(&its->is_stale) ? renew(its) : LOEWNER_OK;
    pthread_mutex_unlock(&its->lock);
    return outcome;
}

loewner_status take_workspace(loewner_workspace *workspace, loewner_workspace **held)
{
    TRY(expect_pointer(workspace, 1, "workspace"));
    if (atomic_flag_test_and_set_explicit(&workspace->is_used, memory_order_acquire))
        return fail(LOEWNER_BAD_ARGUMENT,
                    "workspace: expected one for each thread, found one that another thread uses now");
    *held = workspace;
    return LOEWNER_OK;
}

loewner_status prepare(const loewner_checker *checker, loewner_workspace *workspace)
{
    TRY(settle_scene(checker));
    workspace->checker = checker;
    return workspace->serial == checker->serial ? LOEWNER_OK : bind(checker, workspace);
}

loewner_status prepare_exact(const loewner_checker *checker, loewner_workspace *workspace)
{
    TRY(prepare(checker, workspace));
    for (int32_t b = 0; checker->state.growing > 0 && b < checker->body_count; b++)
        REQUIRE(!checker->bodies[b].has_bounds || !checker->bodies[b].is_present,
                "expected a proof of motions or curves, since the pose of %.100s is known by bounds only; end them for "
                "other queries", checker->bodies[b].name);
    return LOEWNER_OK;
}

/* -- checkers ------------------------------------------------------------------------------------------------------ */

/* Open a checker's file, and create the list of bodies from it. */
static loewner_status load(loewner_checker *checker, const char *path)
{
    TRY(open_file(path, &checker->file));
    File *file = checker->file;
    if (file->moving == 0 || file->dof == 0)
        return fail(LOEWNER_BAD_FILE, "%.300s: expected a robot that CollisionChecker.save wrote, found bodies only",
                    path);
    if (check_poses(file->poses, (size_t)(file->bodies - file->moving), "poses") != LOEWNER_OK)
        return fail(LOEWNER_BAD_FILE, "%.300s: the file is damaged: poses", path);
    TRY(allocate(&checker->bodies, (size_t)file->bodies * sizeof(Body)));
    checker->body_count = (int32_t)file->bodies;
    for (int32_t b = 0; b < checker->body_count; b++) {
        Body *body = checker->bodies + b;
        *body = (Body){.name = (char *)file->names[b], .file = file, .which = b, .link = -1, .is_present = 1};
        if (b < file->moving)
            body->link = file->link[b];
        else
            memcpy(body->pose, file->poses + 16 * (b - file->moving), sizeof body->pose);
    }
    return renew(checker);
}

loewner_status loewner_checker_open(const char *path, loewner_checker **checker)
{
    REQUIRE(path != NULL && checker != NULL, "path, checker: expected pointers, found NULL");
    *checker = NULL;
    if (kernels() == NULL)
        return LOEWNER_NO_KERNELS;
    loewner_checker *made;
    TRY(allocate(&made, sizeof *made));
    pthread_mutex_init(&made->lock, NULL);
    atomic_init(&made->is_stale, 2);
    loewner_status outcome = load(made, path);
    if (outcome == LOEWNER_OK)
        *checker = made;
    else
        loewner_checker_close(made);
    return outcome;
}

void loewner_checker_close(loewner_checker *checker)
{
    if (checker == NULL)
        return;
    leave_state(&checker->state);
    for (int32_t b = 0; b < checker->body_count; b++) {
        Body *body = checker->bodies + b;
        free(body->touch);
        if (b >= checker->file->bodies) {
            free(body->name);
            leave_file(body->file);
        }
    }
    free(checker->bodies);
    free(checker->rules);
    pthread_mutex_destroy(&checker->lock);
    leave_file(checker->file);
    free(checker);
}

int32_t loewner_checker_dof(const loewner_checker *checker)
{
    return checker == NULL ? 0 : (int32_t)checker->file->dof;
}

int32_t loewner_checker_link_count(const loewner_checker *checker)
{
    return checker == NULL ? 0 : (int32_t)checker->file->links;
}

int32_t loewner_checker_body_count(const loewner_checker *checker)
{
    return checker == NULL ? 0 : checker->body_count;
}

int64_t loewner_checker_pair_count(const loewner_checker *checker)
{
    return settle_scene(checker) == LOEWNER_OK ? checker->state.pairs : 0;
}

void write_bodies(const State *state, int64_t pair, int32_t bodies[2])
{
    for (int side = 0; side < 2; side++)
        bodies[side] = pair < 0 ? -1 : state->body[state->pair_list[2 * pair + side]];
}

loewner_status loewner_checker_pair(const loewner_checker *checker, int64_t pair, int32_t bodies[2])
{
    TRY(settle_scene(checker));
    REQUIRE(bodies != NULL && pair >= 0 && pair < checker->state.pairs, "pair: expected a number below %lld",
            (long long)checker->state.pairs);
    write_bodies(&checker->state, pair, bodies);
    return LOEWNER_OK;
}

const char *loewner_checker_value_name(const loewner_checker *checker, int32_t value)
{
    int known = checker != NULL && value >= 0 && value < checker->file->dof;
    return known ? checker->file->names[checker->file->bodies + checker->file->links + value] : NULL;
}

const char *loewner_checker_link_name(const loewner_checker *checker, int32_t link)
{
    int known = checker != NULL && link >= 0 && link < checker->file->links;
    return known ? checker->file->names[checker->file->bodies + link] : NULL;
}

const char *loewner_checker_body_name(const loewner_checker *checker, int32_t body)
{
    return checker != NULL && body >= 0 && body < checker->body_count ? checker->bodies[body].name : NULL;
}

int32_t loewner_checker_find_link(const loewner_checker *checker, const char *name)
{
    for (int32_t k = 0; name != NULL && k < loewner_checker_link_count(checker); k++)
        if (strcmp(loewner_checker_link_name(checker, k), name) == 0)
            return k;
    return -1;
}

int32_t loewner_checker_find_body(const loewner_checker *checker, const char *name)
{
    for (int32_t k = 0; name != NULL && k < loewner_checker_body_count(checker); k++)
        if (strcmp(checker->bodies[k].name, name) == 0)
            return k;
    return -1;
}

loewner_status loewner_checker_limits(const loewner_checker *checker, double *lower, double *upper)
{
    REQUIRE(checker != NULL && lower != NULL && upper != NULL, "checker, lower, upper: expected pointers, found NULL");
    size_t size = sizeof(double) * (size_t)checker->file->dof;
    memcpy(lower, checker->file->limits, size);
    memcpy(upper, checker->file->limits + checker->file->dof, size);
    return LOEWNER_OK;
}

/* -- changes ------------------------------------------------------------------------------------------------------- */

static void spoil(loewner_checker *checker, int how)
{
    if (atomic_load(&checker->is_stale) < how)
        atomic_store(&checker->is_stale, how);
}

static loewner_status expect_body(const loewner_checker *checker, int32_t body)
{
    TRY(expect_pointer(checker, 1, "checker"));
    REQUIRE(body >= 0 && body < checker->body_count, "body: expected a number below %d, found %d", checker->body_count,
            body);
    return LOEWNER_OK;
}

loewner_status loewner_checker_move(loewner_checker *checker, const int32_t *bodies, const double *poses, size_t n)
{
    REQUIRE(checker != NULL && (n == 0 || (bodies != NULL && poses != NULL)),
            "checker, bodies, poses: expected pointers, found NULL");
    TRY(check_poses(poses, n, "poses"));
    for (size_t k = 0; k < n; k++) {
        TRY(expect_body(checker, bodies[k]));
        REQUIRE(checker->bodies[bodies[k]].link < 0,
                "bodies: expected bodies that stand in the scene, found %s, which is on a link",
                checker->bodies[bodies[k]].name);
    }
    for (size_t k = 0; k < n; k++)
        memcpy(checker->bodies[bodies[k]].pose, poses + 16 * k, 16 * sizeof(double));
    if (n > 0)
        spoil(checker, 1);
    return LOEWNER_OK;
}

loewner_status loewner_checker_add(loewner_checker *checker, const char *name, const loewner_bodies *bodies,
                                   int64_t which, const double *pose, int32_t *body)
{
    REQUIRE(checker != NULL && name != NULL && *name != '\0' && bodies != NULL && pose != NULL,
            "checker, name, bodies, pose: expected a name and pointers, found none or NULL");
    REQUIRE(which >= 0 && which < bodies->bodies, "which: expected a number below %lld, found %lld",
            (long long)bodies->bodies, (long long)which);
    REQUIRE(loewner_checker_find_body(checker, name) < 0 && loewner_checker_find_link(checker, name) < 0,
            "name: expected a new one, found %.200s, which there is already", name);
    TRY(check_poses(pose, 1, "pose"));
    TRY(enlarge(&checker->bodies, sizeof(Body) * ((size_t)checker->body_count + 1)));
    Body *made = checker->bodies + checker->body_count;
    *made = (Body){.name = strdup(name), .file = (File *)bodies, .which = which, .link = -1, .is_present = 1};
    if (made->name == NULL)
        return no_memory();
    memcpy(made->pose, pose, sizeof made->pose);
    atomic_fetch_add(&made->file->users, 1);
    if (body != NULL)
        *body = checker->body_count;
    checker->body_count++;
    spoil(checker, 2);
    return LOEWNER_OK;
}

loewner_status loewner_checker_set_present(loewner_checker *checker, int32_t body, int present)
{
    TRY(expect_body(checker, body));
    checker->bodies[body].is_present = present != 0;
    spoil(checker, 2);
    return LOEWNER_OK;
}

loewner_status loewner_checker_attach(loewner_checker *checker, int32_t body, int32_t link, const double *pose_in_link,
                                      const int32_t *touch_links, size_t touch_count)
{
    TRY(expect_body(checker, body));
    REQUIRE(pose_in_link != NULL && (touch_count == 0 || touch_links != NULL),
            "pose_in_link, touch_links: expected pointers, found NULL");
    Body *its = checker->bodies + body;
    REQUIRE(its->link < 0 || its->is_attached,
            "body: expected a body of the scene, found %s, which belongs to the robot", its->name);
    TRY(check_poses(pose_in_link, 1, "pose_in_link"));
    for (size_t k = 0; k <= touch_count; k++) {
        int32_t named = k < touch_count ? touch_links[k] : link;
        REQUIRE(named >= 0 && named < checker->file->links, "link, touch_links: expected numbers below %d, found %d",
                (int)checker->file->links, named);
    }
    int32_t *touch;
    TRY(allocate(&touch, sizeof *touch * (touch_count + 1)));
    if (touch_count > 0)
        memcpy(touch, touch_links, sizeof *touch * touch_count);
    free(its->touch);
    its->touch = touch;
    its->touch_count = touch_count;
    its->link = link;
    its->is_attached = 1;
    its->has_bounds = 0;
    memcpy(its->pose, pose_in_link, sizeof its->pose);
    spoil(checker, 2);
    return LOEWNER_OK;
}

loewner_status loewner_checker_detach(loewner_checker *checker, int32_t body, const double *pose)
{
    TRY(expect_body(checker, body));
    Body *its = checker->bodies + body;
    REQUIRE(its->is_attached, "body: expected an attached one, found %s", its->name);
    TRY(check_poses(pose, 1, "pose"));
    its->link = -1;
    its->is_attached = 0;
    its->touch_count = 0;
    memcpy(its->pose, pose, sizeof its->pose);
    spoil(checker, 2);
    return LOEWNER_OK;
}

/* Find the rule for a pair; add one if the pair has none. */
static loewner_status its_rule(loewner_checker *checker, int32_t a, int32_t b, Rule **rule)
{
    TRY(expect_body(checker, a));
    TRY(expect_body(checker, b));
    REQUIRE(a != b, "a, b: expected two bodies, found %d twice", a);
    int32_t low = a < b ? a : b, high = a < b ? b : a;
    int64_t known = row_of((const int64_t *)checker->rules, (int64_t)checker->rule_count, sizeof(Rule) / 8, low, high);
    if (known < 0) {
        TRY(enlarge(&checker->rules, sizeof(Rule) * (checker->rule_count + 1)));
        known = (int64_t)checker->rule_count++;
        checker->rules[known] = (Rule){.a = low, .b = high, .touch = -1, .margin = -1};
    }
    *rule = checker->rules + known;
    spoil(checker, 2);
    return LOEWNER_OK;
}

loewner_status loewner_checker_allow(loewner_checker *checker, int32_t a, int32_t b, int allowed)
{
    Rule *rule;
    TRY(its_rule(checker, a, b, &rule));
    const File *file = checker->file;
    REQUIRE(allowed || rule->a >= file->moving || rule->b >= file->bodies ||
            row_of(file->pair_list, file->pairs, 2, rule->a, rule->b) >= 0,
            "expected a pair that was checked when the file was saved, found %.100s and %.100s",
            checker->bodies[rule->a].name, checker->bodies[rule->b].name);
    /* By default, a pair is checked. Only a rule of the file, which may exclude two static bodies, has to be
       overridden. */
    int is_ruled = row_of(file->rules, file->rule_count, 3, rule->a, rule->b) >= 0;
    rule->touch = allowed ? 1 : is_ruled ? 0 : -1;
    return LOEWNER_OK;
}

loewner_status loewner_checker_set_bounds(loewner_checker *checker, int32_t body, const loewner_bounds *bounds)
{
    TRY(expect_body(checker, body));
    Body *its = checker->bodies + body;
    REQUIRE(its->link < 0, "body: expected a body that stands in the scene, found %s, which is on a link", its->name);
    for (int k = 0; bounds != NULL && k < 4; k++) {
        double number = (const double[]){bounds->metres, bounds->radians, bounds->speed, bounds->turn}[k];
        REQUIRE(number >= 0 && number < INFINITY && fabs(bounds->since) < INFINITY,
                "bounds: expected numbers >= 0 and a finite time, found others");
    }
    if (its->has_bounds != (bounds != NULL))
        spoil(checker, 2);
    its->has_bounds = bounds != NULL;
    if (bounds != NULL)
        its->bounds = *bounds;
    return LOEWNER_OK;
}

loewner_status loewner_checker_set_margin(loewner_checker *checker, int32_t a, int32_t b, double margin)
{
    Rule *rule;
    REQUIRE(margin >= 0 && margin <= 1e30, "margin: expected a number >= 0, found %g", margin);
    TRY(its_rule(checker, a, b, &rule));
    rule->margin = margin;
    return LOEWNER_OK;
}
