/* The bodies of a checker, their poses, and the pairs to check, as kernels take them; by the rules of `Problem.of` in
   `loewner/robots/checking/problem.py`. */

#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static _Atomic uint64_t serials = 1;

/* -- memory of a state --------------------------------------------------------------------------------------------- */

/* Memory that lives as long as the state; NULL if there is none. */
static void *room(State *state, int64_t count, size_t size)
{
    size_t bytes = ((size_t)count * size + CACHE_LINE) / CACHE_LINE * CACHE_LINE; /* at least one line */
    void *made = aligned_alloc(CACHE_LINE, bytes);
    if (made == NULL || state->memory_count == (int)(sizeof state->memory / sizeof *state->memory)) {
        free(made);
        return NULL;
    }
    memset(made, 0, bytes);
    state->memory[state->memory_count++] = made;
    return made;
}

static void leave_half(Half *half)
{
    free(half->joined);
    free(half->block);
}

static void leave_state(State *state)
{
    for (int k = 0; k < CUTTINGS; k++)
        leave_half(state->halves + k);
    for (int k = 0; k < state->memory_count; k++)
        free(state->memory[k]);
    memset(state, 0, sizeof *state);
}

/* -- packs of chosen bodies ---------------------------------------------------------------------------------------- */

typedef struct {
    int64_t bodies, pieces, numbers, groups, parts;
} Counts;

/* Where the arrays of one body begin in its pack, and how long they are. */
static void range_of(const Pack *pack, int64_t which, Counts *from, Counts *count)
{
    int64_t first = pack->piece_start[which], last = pack->piece_start[which + 1];
    from->pieces = first;
    count->pieces = last - first;
    from->numbers = first < pack->pieces ? 3 * pack->layout[LAYOUT * first + POINTS_FROM] : pack->numbers;
    int64_t end = last < pack->pieces ? 3 * pack->layout[LAYOUT * last + POINTS_FROM] : pack->numbers;
    count->numbers = end - from->numbers;
    count->groups = pack->roots[which] < 0 ? 0 : groups_of(last - first);
    from->groups = pack->roots[which] + 1 - count->groups;
    count->parts = 0;
    for (int64_t p = first; pack->has_parts && p < last; p++)
        count->parts += pack->part_start[PARTS * p + 2] - pack->part_start[PARTS * p];
}

/* Whether pieces of a body are solids. */
static int is_solid(const Body *body)
{
    const Pack *pack = body->file->packs + WHOLE;
    for (int64_t p = pack->piece_start[body->which]; p < pack->piece_start[body->which + 1]; p++)
        if (pack->layout[LAYOUT * p + KIND_OF] == SOLID)
            return 1;
    return 0;
}

/* The first link with which one is rigidly joined; -1 is the world. */
static int64_t rigid_link(const Tree *tree, int64_t link)
{
    return tree->kind[link] == FIXED ? tree->parent[link] : link;
}

/* Whether the body at a place never moves. */
static int stands(const State *state, int64_t k)
{
    return k >= state->moving || rigid_link(&state->tree, state->link[k]) == rigid_link(&state->tree, 0);
}

/* The pack of the body at a place. */
static const Pack *pack_of(const State *state, const Body *body, int64_t k, Cutting cutting)
{
    int is_whole = !body->file->has_cut || (cutting == OPEN_CUT && !stands(state, k));
    return body->file->packs + (is_whole ? WHOLE : cutting);
}

/* Append one body; `at` is where its arrays begin. */
static void append(Pack *made, const Pack *pack, int64_t which, Counts *at)
{
    Counts from, count;
    range_of(pack, which, &from, &count);
    int64_t first = from.pieces, q = at->pieces, shift = (at->numbers - from.numbers) / 3;
#define COPY(array, width, from_row, to_row, rows)                                                                     \
    memcpy((void *)(made->array + (width) * (to_row)), pack->array + (width) * (from_row),                             \
           (size_t)((width) * (rows)) * sizeof *made->array)
    COPY(table, COLUMNS, first, q, count.pieces);
    COPY(hot, HOT, first, q, count.pieces);
    COPY(points, 1, from.numbers, at->numbers, count.numbers);
    if (made->is_single && count.pieces > 0) {
        COPY(single, HOT, first, q, count.pieces);
        COPY(vertices, 1, from.numbers, at->numbers, count.numbers);
    }
    COPY(tree_groups, 48, from.groups, at->groups, count.groups);
#undef COPY
    int64_t *layout = (int64_t *)made->layout, *children = (int64_t *)made->children;
    int64_t *part_start = (int64_t *)made->part_start;
    double *part_rows = (double *)made->part_rows;
    for (int64_t p = 0; p < count.pieces; p++) {
        int64_t *row = layout + LAYOUT * (q + p);
        memcpy(row, pack->layout + LAYOUT * (first + p), sizeof(int64_t) * LAYOUT);
        row[POINTS_FROM] += shift;
        row[POINTS_TO] += shift;
        if (!made->has_parts)
            continue;
        const int64_t none[PARTS] = {0, 0, 0}, *rows = pack->has_parts ? pack->part_start + PARTS * (first + p) : none;
        for (int k = 0; k < PARTS; k++)
            part_start[PARTS * (q + p) + k] = rows[2] > rows[0] ? at->parts + rows[k] - rows[0] : 0;
        memcpy(part_rows + HOT * at->parts, pack->part_rows + HOT * rows[0],
               sizeof(double) * (size_t)(HOT * (rows[2] - rows[0])));
        at->parts += rows[2] - rows[0];
    }
    for (int64_t c = 0; c < WIDE * count.groups; c++) {
        int64_t child = pack->children[WIDE * from.groups + c];
        children[WIDE * at->groups + c] = child >= 0                 ? child - from.groups + at->groups
                                          : child == -1 && first > 0 ? -1
                                                                     : ~(~child - first + q);
    }
    ((int64_t *)made->roots)[at->bodies] = count.groups == 0 ? -1 : at->groups + count.groups - 1;
    at->bodies++;
    at->pieces += count.pieces;
    at->numbers += count.numbers;
    at->groups += count.groups;
    ((int64_t *)made->piece_start)[at->bodies] = at->pieces;
}

/* Make one pack of the bodies of a state. */
static loewner_status join(const loewner_checker *checker, const State *state, Cutting cutting, Half *half)
{
    int64_t bodies = state->moving + state->standing;
    Pack *made = &half->pack;
    Counts total = {0}, at = {0};
    *made = (Pack){.bodies = bodies, .is_single = 1};
    for (int64_t k = 0; k < bodies; k++) {
        const Body *body = checker->bodies + state->body[k];
        const Pack *pack = pack_of(state, body, k, cutting);
        Counts from, count;
        range_of(pack, body->which, &from, &count);
        total.pieces += count.pieces;
        total.numbers += count.numbers;
        total.groups += count.groups;
        total.parts += count.parts;
        made->is_single &= pack->is_single || count.pieces == 0;
        made->has_parts |= pack->has_parts;
    }
    made->is_single &= total.pieces > 0;
    made->pieces = total.pieces;
    made->numbers = total.numbers;
    made->groups = total.groups;
    made->parts = total.parts;
    int64_t starts = made->has_parts ? PARTS * total.pieces : 0;
    const void **const arrays[] = {
        (const void **)&made->table,       (const void **)&made->layout,    (const void **)&made->points,
        (const void **)&made->piece_start, (const void **)&made->hot,       (const void **)&made->single,
        (const void **)&made->tree_groups, (const void **)&made->children,  (const void **)&made->roots,
        (const void **)&made->vertices,    (const void **)&made->part_rows, (const void **)&made->part_start,
    };
    const int64_t sizes[] = {
        8 * COLUMNS * total.pieces, 8 * LAYOUT * total.pieces, 8 * total.numbers,
        8 * (bodies + 1),           8 * HOT * total.pieces,    4 * HOT * total.pieces,
        8 * 48 * total.groups,      8 * WIDE * total.groups,   8 * bodies,
        4 * total.numbers,          8 * HOT * total.parts,     8 * starts,
    };
    int64_t bytes = 0;
    for (int k = 0; k < PACK_ARRAYS; k++)
        bytes += (sizes[k] + 2 * CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    char *memory = half->joined = aligned_alloc(CACHE_LINE, (size_t)bytes);
    if (memory == NULL)
        return no_memory();
    for (int k = 0; k < PACK_ARRAYS; k++) {
        *arrays[k] = memory;
        memory += (sizes[k] + 2 * CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    }
    ((int64_t *)made->piece_start)[0] = 0;
    for (int64_t k = 0; k < bodies; k++) {
        const Body *body = checker->bodies + state->body[k];
        append(made, pack_of(state, body, k, cutting), body->which, &at);
    }
    return LOEWNER_OK;
}

/* -- links --------------------------------------------------------------------------------------------------------- */

/* The product of a link's constant pose and a pose, as constants. */
static void place_link(const double *constants, const double *pose, double *made)
{
    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++) {
            double entry = 0;
            for (int m = 0; m < 3; m++)
                entry += constants[3 * r + m] * pose[4 * m + c];
            made[3 * r + c] = entry;
        }
        double shift = constants[TRANSLATION + r];
        for (int m = 0; m < 3; m++)
            shift += constants[3 * r + m] * pose[4 * m + 3];
        made[TRANSLATION + r] = shift;
    }
}

/* The robot's links, then a fixed one for each attached body. */
static loewner_status grow_tree(const loewner_checker *checker, State *state)
{
    const Tree *given = &checker->file->tree;
    int64_t more = 0, links = given->links;
    for (int32_t b = 0; b < checker->body_count; b++)
        more += checker->bodies[b].is_attached && checker->bodies[b].is_present;
    state->tree = *given;
    if (more == 0)
        return LOEWNER_OK;
    state->tree.links = links + more;
    const void **const arrays[] = {
        (const void **)&state->tree.parent, (const void **)&state->tree.kind,
        (const void **)&state->tree.column, (const void **)&state->tree.multiplier,
        (const void **)&state->tree.offset, (const void **)&state->tree.constants,
    };
    for (int k = 0; k < 6; k++) {
        size_t size = k < 5 ? 8 : 8 * LINK_CONSTANTS;
        void *made = room(state, links + more, size);
        if (made == NULL)
            return no_memory();
        memcpy(made, *arrays[k], (size_t)links * size);
        *arrays[k] = made;
    }
    return LOEWNER_OK;
}

static void add_link(State *state, int64_t number, const Body *body, const Tree *given)
{
    static const double at_link[LINK_CONSTANTS] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    int is_fixed = given->kind[body->link] == FIXED;
    ((int64_t *)state->tree.parent)[number] = rigid_link(given, body->link);
    ((int64_t *)state->tree.kind)[number] = FIXED;
    ((double *)state->tree.multiplier)[number] = 1;
    place_link(is_fixed ? given->constants + LINK_CONSTANTS * body->link : at_link, body->pose,
               (double *)state->tree.constants + LINK_CONSTANTS * number);
}

/* -- pairs --------------------------------------------------------------------------------------------------------- */

static const Rule *rule_of(const loewner_checker *checker, int32_t a, int32_t b)
{
    for (size_t k = 0; k < checker->rule_count; k++)
        if (checker->rules[k].a == a && checker->rules[k].b == b)
            return checker->rules + k;
    return NULL;
}

/* The row of a table that begins with two bodies, a < b; -1 if there is none. */
static int64_t row_of(const int64_t *rows, int64_t count, int64_t width, int64_t a, int64_t b)
{
    for (int64_t k = 0; k < count; k++)
        if (rows[width * k] == a && rows[width * k + 1] == b)
            return k;
    return -1;
}

/* Whether the bodies are exactly the bodies of the file, all present, with its pairs. */
static int is_as_saved(const loewner_checker *checker)
{
    int is = checker->body_count == checker->file->bodies && checker->rule_count == 0;
    for (int32_t b = 0; is && b < checker->body_count; b++)
        is = checker->bodies[b].is_present && !checker->bodies[b].is_attached;
    return is;
}

enum { RULE = 4 };

/* Rules for pairs, as `list_pairs` takes them. */
typedef struct {
    int64_t *rows, count;
    double *margins;
} Rules;

/* Append a rule for two bodies: `touch` is -1 if it is about the margin only, and `margin` if it has none. */
static void add_rule(const State *state, Rules *rules, int64_t a, int64_t b, int64_t touch, double margin)
{
    const int64_t row[RULE] = {state->place[a], state->place[b], touch, 1};
    memcpy(rules->rows + RULE * rules->count, row, sizeof row);
    rules->margins[rules->count++] = margin;
}

/* Rules of the file, of the user, and of attached bodies, which may touch the own bodies of their touch links. */
static void list_rules(const loewner_checker *checker, const State *state, Rules *rules)
{
    const File *file = checker->file;
    int64_t at = 0;
    for (int64_t a = 0; a < file->moving; a++) /* of a body that moves in the file, the file lists all pairs */
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
        add_rule(state, rules, its->a, its->b, its->has_allowed ? its->allowed : -1, its->has_margin ? its->margin : -1);
    for (int32_t b = 0; b < checker->body_count; b++)
        for (size_t k = 0; k < checker->bodies[b].touch_count; k++) {
            int32_t link = checker->bodies[b].touch[k];
            int32_t other = loewner_checker_find_body(checker, loewner_checker_link_name(checker, link));
            if (other >= 0 && checker->bodies[other].link == link && !checker->bodies[other].is_attached)
                add_rule(state, rules, b, other, 1, -1);
        }
}

/* Choose the pairs among all that contain a moving body, for which there is room. */
static loewner_status choose_pairs(const loewner_checker *checker, State *state, int64_t most)
{
    const File *file = checker->file;
    int64_t bodies = state->moving + state->standing, count = file->moving * file->bodies + file->rule_count;
    count += (int64_t)checker->rule_count;
    for (int32_t b = 0; b < checker->body_count; b++)
        count += (int64_t)checker->bodies[b].touch_count;
    double *own = calloc((size_t)(5 * bodies + (RULE + 1) * count) + 1, sizeof *own);
    if (own == NULL)
        return no_memory();
    int64_t *marks = (int64_t *)(own + 2 * bodies);
    Rules rules = {marks + 3 * bodies, 0, (double *)(marks + 3 * bodies + RULE * count)};
    for (int64_t k = 0; k < bodies; k++)
        if (state->body[k] < file->bodies) {
            own[2 * k] = file->own[state->body[k]];
            marks[3 * k + 1] = file->lowered[state->body[k]];
        }
    list_rules(checker, state, &rules);
    const Tree *tree = &state->tree;
    loewner_status outcome = CALL(
        list_pairs, &state->pairs, .parent = {tree->parent, tree->links}, .kind = {tree->kind, tree->links},
        .link = {state->link, state->moving}, .marks = {marks, bodies, 3}, .own = {own, bodies, 2},
        .least = {&file->margin, 1}, .rules = {rules.rows, rules.count, RULE},
        .rule_margins = {rules.margins, rules.count}, .pairs = {state->pair_list, most, 2},
        .margins = {state->margins, most});
    free(own);
    return outcome;
}

static loewner_status list_pairs(const loewner_checker *checker, State *state)
{
    const File *file = checker->file;
    int64_t bodies = state->moving + state->standing;
    int64_t most = state->is_as_saved ? file->pairs : state->moving * (2 * bodies - state->moving - 1) / 2;
    state->pair_list = room(state, 2 * most, 8);
    state->margins = room(state, most, 8);
    state->order = room(state, most, 8);
    state->rows = room(state, 2 * most, 8);
    if (state->pair_list == NULL || state->margins == NULL || state->order == NULL || state->rows == NULL)
        return no_memory();
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

/* Place the static bodies that have moved where they are, since no other thread may query this checker meanwhile. */
static loewner_status place(const State *state, Half *half)
{
    TRY(CALL(place_static, &half->handle, .pack = (int64_t)&half->pieces, .handle = half->handle,
             .block = {half->block, half->block_words}, .poses = {state->poses, state->standing, 16}));
    half->motions = half->handle + (int64_t)offsetof(Tables, motions);
    return LOEWNER_OK;
}

/* Bytes that the queries of a set of bodies write to. */
static loewner_status measure(const loewner_checker *checker, Half *half, int is_for_motions)
{
    const Kernels *known = kernels();
    const struct memory_size arguments = {(int64_t)&half->pieces, half->handle, checker->file->dof};
    const Kernel sizes[] = {known->memory_size, known->memory_of_nearest, known->memory_of_clearances,
                            known->motion_memory};
    half->memory = known->settle_memory;
    for (int k = 0; k < 3 + is_for_motions; k++) {
        int64_t size = 0;
        TRY(call(sizes[k], &arguments, &size));
        half->memory = size > half->memory ? size : half->memory;
    }
    return LOEWNER_OK;
}

static loewner_status make_half(const loewner_checker *checker, State *state, Cutting cutting, int is_for_motions)
{
    Half *half = state->halves + cutting;
    const Tree *tree = &state->tree;
    int64_t links = tree->links, pairs = state->pairs;
    if (state->is_as_saved)
        half->pack = checker->file->packs[cutting];
    else
        TRY(join(checker, state, cutting, half));
    half->pieces = table_of(&half->pack);
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
    double *lasting = room(state, made.lasting_words, 8);
    half->block_words = made.block_words;
    half->block = aligned_alloc(CACHE_LINE, ((size_t)made.block_words * 8 + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE);
    if (lasting == NULL || half->block == NULL)
        return no_memory();
    asked.lasting = (Array1){lasting, made.lasting_words};
    asked.block = (Array1){half->block, made.block_words};
    TRY(call(kernels()->lay_out, &asked, &made));
    half->handle = made.made;
    TRY(place(state, half));
    return measure(checker, half, is_for_motions);
}

/* -- states -------------------------------------------------------------------------------------------------------- */

/* Order the bodies: the robot's own, then attached ones, then static ones. */
static loewner_status arrange(const loewner_checker *checker, State *state)
{
    int32_t count = checker->body_count;
    state->body = room(state, count, sizeof(int32_t));
    state->place = room(state, count, sizeof(int32_t));
    if (state->body == NULL || state->place == NULL)
        return no_memory();
    for (int group = 0; group < 3; group++)
        for (int32_t b = 0; b < count; b++) {
            const Body *body = checker->bodies + b;
            int its = body->link < 0 ? 2 : body->is_attached;
            if (its != group)
                continue;
            state->place[b] = -1;
            if (!body->is_present)
                continue;
            state->place[b] = (int32_t)(state->moving + state->standing);
            state->body[state->place[b]] = b;
            *(group < 2 ? &state->moving : &state->standing) += 1;
            state->growing += body->has_bounds;
        }
    state->link = room(state, state->moving, 8);
    state->poses = room(state, 16 * state->standing, 8);
    if (state->link == NULL || state->poses == NULL)
        return no_memory();
    int64_t next = checker->file->links;
    for (int64_t k = 0; k < state->moving; k++) {
        const Body *body = checker->bodies + state->body[k];
        state->link[k] = body->is_attached ? next++ : body->link;
    }
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
    for (int64_t k = 0; k < state->moving; k++) {
        const Body *body = checker->bodies + state->body[k];
        if (body->is_attached)
            add_link(state, state->link[k], body, &checker->file->tree);
    }
    TRY(list_pairs(checker, state));
    int has_cut = 0;
    for (int64_t k = 0; k < state->moving + state->standing; k++) {
        const Body *body = checker->bodies + state->body[k];
        has_cut |= body->file->has_cut;
        state->starts_matter |= is_solid(body);
    }
    TRY(make_half(checker, state, WHOLE, !has_cut));
    if (has_cut) {
        TRY(make_half(checker, state, CUT, 1));
        TRY(make_half(checker, state, OPEN_CUT, 0));
    }
    return LOEWNER_OK;
}

/* Take over what changed; the caller holds the lock. */
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
    } else { /* workspaces stay prepared, since all arrays stay where they are */
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
    if (workspace == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "workspace: expected a pointer, found NULL");
    *workspace = calloc(1, sizeof **workspace);
    return *workspace == NULL ? no_memory() : LOEWNER_OK;
}

void loewner_workspace_free(loewner_workspace *workspace)
{
    if (workspace == NULL)
        return;
    free(workspace->block);
    free(workspace->path);
    free(workspace);
}

typedef struct {
    void **field;
    size_t size;
} Part;

static loewner_status bind(const loewner_checker *checker, loewner_workspace *workspace)
{
    const State *state = &checker->state;
    const Half *half = half_of(checker, CUT);
    size_t dof = (size_t)checker->file->dof, pairs = (size_t)state->pairs,
           bodies = (size_t)(state->moving + state->standing);
    size_t memory = 0;
    for (int k = 0; k < CUTTINGS; k++)
        memory = (size_t)state->halves[k].memory > memory ? (size_t)state->halves[k].memory : memory;
    const Part parts[] = {
        {(void **)&workspace->memory, memory},
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
    size_t total = 0, count = sizeof parts / sizeof *parts;
    for (size_t k = 0; k < count; k++)
        total += (parts[k].size + 2 * CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    if (workspace->size < total) {
        workspace->serial = 0;
        free(workspace->block);
        workspace->size = 0;
        workspace->block = aligned_alloc(CACHE_LINE, total);
        if (workspace->block == NULL)
            return no_memory();
        workspace->size = total;
    }
    char *at = workspace->block;
    for (size_t k = 0; k < count; k++) {
        *parts[k].field = at;
        at += (parts[k].size + 2 * CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    }
    /* The order of pairs is the workspace's own: it learns which collide most often. */
    memcpy(&workspace->tables, (const void *)state->halves[WHOLE].handle, sizeof workspace->tables);
    memcpy(workspace->order, state->order, 8 * pairs);
    memset(workspace->hits, 0, 8 * pairs);
    workspace->tables.problem.order.data = workspace->order;
    workspace->pack = (int64_t)&state->halves[WHOLE].pieces;
    workspace->seen = 0;
    workspace->is_ready = 0;
    workspace->next_look = FIRST_LOOK;
    workspace->serial = checker->serial;
    return LOEWNER_OK;
}

/* Take over changes of the scene, by one of the threads that query it. */
static loewner_status settle_scene(const loewner_checker *checker)
{
    if (checker == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "checker: expected a pointer, found NULL");
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
    if (workspace == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "workspace: expected a pointer, found NULL");
    if (atomic_flag_test_and_set_explicit(&workspace->is_used, memory_order_acquire))
        return fail(LOEWNER_BAD_ARGUMENT,
                    "workspace: expected one for each thread, found one that another thread uses now");
    *held = workspace;
    return LOEWNER_OK;
}

loewner_status prepare(const loewner_checker *checker, loewner_workspace *workspace)
{
    TRY(settle_scene(checker));
    return workspace->serial == checker->serial ? LOEWNER_OK : bind(checker, workspace);
}

loewner_status prepare_exact(const loewner_checker *checker, loewner_workspace *workspace)
{
    TRY(prepare(checker, workspace));
    for (int32_t b = 0; checker->state.growing > 0 && b < checker->body_count; b++)
        if (checker->bodies[b].has_bounds && checker->bodies[b].is_present)
            return fail(LOEWNER_BAD_ARGUMENT,
                        "expected a proof of motions or curves, since the pose of %.100s is known by bounds only; end "
                        "them for other queries",
                        checker->bodies[b].name);
    return LOEWNER_OK;
}

/* -- checkers ------------------------------------------------------------------------------------------------------ */

loewner_status loewner_checker_open(const char *path, loewner_checker **checker)
{
    if (path == NULL || checker == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "path, checker: expected pointers, found NULL");
    *checker = NULL;
    if (kernels() == NULL)
        return LOEWNER_NO_KERNELS;
    File *file;
    TRY(open_file(path, &file));
    loewner_status outcome = LOEWNER_OK;
    loewner_checker *made = calloc(1, sizeof *made);
    if (made != NULL)
        made->bodies = calloc((size_t)file->bodies + 1, sizeof *made->bodies);
    if (made == NULL || made->bodies == NULL)
        outcome = no_memory();
    else if (file->moving == 0 || file->dof == 0)
        outcome = fail(LOEWNER_BAD_FILE, "%.300s: expected a robot that CollisionChecker.save wrote, found bodies only",
                       path);
    if (outcome != LOEWNER_OK) {
        if (made != NULL)
            free(made->bodies);
        free(made);
        leave_file(file);
        return outcome;
    }
    pthread_mutex_init(&made->lock, NULL);
    atomic_init(&made->is_stale, 2);
    made->file = file;
    made->body_count = (int32_t)file->bodies;
    for (int32_t b = 0; b < made->body_count; b++) {
        Body *body = made->bodies + b;
        *body = (Body){.name = (char *)file->names[b], .file = file, .which = b, .link = -1, .is_present = 1};
        if (b < file->moving)
            body->link = file->link[b];
        else
            memcpy(body->pose, file->poses + 16 * (b - file->moving), sizeof body->pose);
    }
    if (check_poses(file->poses, (size_t)(file->bodies - file->moving), "poses") != LOEWNER_OK)
        outcome = fail(LOEWNER_BAD_FILE, "%.300s: the file is damaged: poses", path);
    else
        outcome = renew(made);
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

loewner_status loewner_checker_pair(const loewner_checker *checker, int64_t pair, int32_t bodies[2])
{
    TRY(settle_scene(checker));
    if (bodies == NULL || pair < 0 || pair >= checker->state.pairs)
        return fail(LOEWNER_BAD_ARGUMENT, "pair: expected a number below %lld", (long long)checker->state.pairs);
    for (int k = 0; k < 2; k++)
        bodies[k] = checker->state.body[checker->state.pair_list[2 * pair + k]];
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
    if (checker == NULL || lower == NULL || upper == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "checker, lower, upper: expected pointers, found NULL");
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
    if (checker == NULL)
        return fail(LOEWNER_BAD_ARGUMENT, "checker: expected a pointer, found NULL");
    if (body < 0 || body >= checker->body_count)
        return fail(LOEWNER_BAD_ARGUMENT, "body: expected a number below %d, found %d", checker->body_count, body);
    return LOEWNER_OK;
}

loewner_status loewner_checker_move(loewner_checker *checker, const int32_t *bodies, const double *poses, size_t n)
{
    if (checker == NULL || (n > 0 && (bodies == NULL || poses == NULL)))
        return fail(LOEWNER_BAD_ARGUMENT, "checker, bodies, poses: expected pointers, found NULL");
    TRY(check_poses(poses, n, "poses"));
    for (size_t k = 0; k < n; k++) {
        TRY(expect_body(checker, bodies[k]));
        if (checker->bodies[bodies[k]].link >= 0)
            return fail(LOEWNER_BAD_ARGUMENT,
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
    if (checker == NULL || name == NULL || *name == '\0' || bodies == NULL || pose == NULL)
        return fail(LOEWNER_BAD_ARGUMENT,
                    "checker, name, bodies, pose: expected a name and pointers, found none or NULL");
    if (which < 0 || which >= bodies->file->bodies)
        return fail(LOEWNER_BAD_ARGUMENT, "which: expected a number below %lld, found %lld",
                    (long long)bodies->file->bodies, (long long)which);
    if (loewner_checker_find_body(checker, name) >= 0 || loewner_checker_find_link(checker, name) >= 0)
        return fail(LOEWNER_BAD_ARGUMENT, "name: expected a new one, found %.200s, which there is already", name);
    TRY(check_poses(pose, 1, "pose"));
    Body *more = realloc(checker->bodies, sizeof *more * ((size_t)checker->body_count + 1));
    if (more == NULL)
        return no_memory();
    checker->bodies = more;
    size_t length = strlen(name) + 1;
    char *copy = malloc(length);
    if (copy == NULL)
        return no_memory();
    memcpy(copy, name, length);
    Body *made = checker->bodies + checker->body_count;
    *made = (Body){.name = copy, .file = bodies->file, .which = which, .link = -1, .is_present = 1};
    memcpy(made->pose, pose, sizeof made->pose);
    atomic_fetch_add(&bodies->file->users, 1);
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
    if (pose_in_link == NULL || (touch_count > 0 && touch_links == NULL))
        return fail(LOEWNER_BAD_ARGUMENT, "pose_in_link, touch_links: expected pointers, found NULL");
    Body *its = checker->bodies + body;
    if (its->link >= 0 && !its->is_attached)
        return fail(LOEWNER_BAD_ARGUMENT, "body: expected a body of the scene, found %s, which belongs to the robot",
                    its->name);
    TRY(check_poses(pose_in_link, 1, "pose_in_link"));
    for (size_t k = 0; k <= touch_count; k++) {
        int32_t named = k < touch_count ? touch_links[k] : link;
        if (named < 0 || named >= checker->file->links)
            return fail(LOEWNER_BAD_ARGUMENT, "link, touch_links: expected numbers below %d, found %d",
                        (int)checker->file->links, named);
    }
    int32_t *touch = malloc(sizeof *touch * (touch_count + 1));
    if (touch == NULL)
        return no_memory();
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
    if (!its->is_attached)
        return fail(LOEWNER_BAD_ARGUMENT, "body: expected an attached one, found %s", its->name);
    TRY(check_poses(pose, 1, "pose"));
    its->link = -1;
    its->is_attached = 0;
    its->touch_count = 0;
    memcpy(its->pose, pose, sizeof its->pose);
    spoil(checker, 2);
    return LOEWNER_OK;
}

/* The rule of a pair, made if there is none. */
static loewner_status its_rule(loewner_checker *checker, int32_t a, int32_t b, Rule **rule)
{
    TRY(expect_body(checker, a));
    TRY(expect_body(checker, b));
    if (a == b)
        return fail(LOEWNER_BAD_ARGUMENT, "a, b: expected two bodies, found %d twice", a);
    int32_t low = a < b ? a : b, high = a < b ? b : a;
    *rule = (Rule *)rule_of(checker, low, high);
    if (*rule == NULL) {
        Rule *more = realloc(checker->rules, sizeof *more * (checker->rule_count + 1));
        if (more == NULL)
            return no_memory();
        checker->rules = more;
        *rule = more + checker->rule_count++;
        **rule = (Rule){.a = low, .b = high};
    }
    spoil(checker, 2);
    return LOEWNER_OK;
}

loewner_status loewner_checker_allow(loewner_checker *checker, int32_t a, int32_t b, int allowed)
{
    Rule *rule;
    TRY(its_rule(checker, a, b, &rule));
    const File *file = checker->file;
    if (!allowed && rule->a < file->moving && rule->b < file->bodies &&
        row_of(file->pair_list, file->pairs, 2, rule->a, rule->b) < 0)
        return fail(LOEWNER_BAD_ARGUMENT,
                    "expected a pair that was checked when the file was saved, found %.100s and %.100s",
                    checker->bodies[rule->a].name, checker->bodies[rule->b].name);
    /* Pairs are checked unless the file excludes them; it may do so by a rule for two static bodies. */
    rule->has_allowed = allowed || row_of(file->rules, file->rule_count, 3, rule->a, rule->b) >= 0;
    rule->allowed = allowed != 0;
    return LOEWNER_OK;
}

loewner_status loewner_checker_set_bounds(loewner_checker *checker, int32_t body, const loewner_bounds *bounds)
{
    TRY(expect_body(checker, body));
    Body *its = checker->bodies + body;
    if (its->link >= 0)
        return fail(LOEWNER_BAD_ARGUMENT,
                    "body: expected a body that stands in the scene, found %s, which is on a link", its->name);
    for (int k = 0; bounds != NULL && k < 4; k++) {
        double number = (const double[]){bounds->metres, bounds->radians, bounds->speed, bounds->turn}[k];
        if (!(number >= 0 && number < INFINITY && fabs(bounds->since) < INFINITY))
            return fail(LOEWNER_BAD_ARGUMENT, "bounds: expected numbers >= 0 and a finite time, found others");
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
    if (!(margin >= 0 && margin <= 1e30))
        return fail(LOEWNER_BAD_ARGUMENT, "margin: expected a number >= 0, found %g", margin);
    TRY(its_rule(checker, a, b, &rule));
    rule->has_margin = 1;
    rule->margin = margin;
    return LOEWNER_OK;
}
