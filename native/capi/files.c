/* This file maps the files that `loewner/bodies/native_files.py` describes. A mapped file is not trusted: its checksum
   reveals damage, but anyone can compute a checksum for a forged file. Every size, index and number in the file is
   therefore checked before a kernel uses it. If a check fails, the error message names the array, the part of the file,
   or the fault. */

#define _GNU_SOURCE
#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#define MAGIC "lwn file"
#define SOURCES_LENGTH 64
#define GOLDEN 0x9E3779B97F4A7C15u

/* Limit on each count, and on the number of entries of an array: sums and small multiples are far from overflow. */
#define MOST ((int64_t)1 << 40)

/* The counts in the header of a file. */
typedef struct {
    int64_t arrays, dof, links, moving, standing, has_cut, surfaces, unused;
} Counts;

enum { INTEGERS, DOUBLES, SINGLES, BYTES };
static const int64_t item_sizes[] = {8, 8, 4, 1};

/* Path of the file that this thread is opening. */
static _Thread_local const char *opened_path;

static loewner_status damaged(const char *what)
{
    return fail(LOEWNER_BAD_FILE, "%.300s: the file is damaged: %s", opened_path, what);
}

#define EXPECT(condition, what)                                                                                        \
    do {                                                                                                               \
        if (!(condition))                                                                                              \
            return damaged(what);                                                                                      \
    } while (0)

/* -- the container ------------------------------------------------------------------------------------------------- */

static uint64_t checksum(const char *content, size_t size)
{
    uint64_t sum = 0, factor = 0;
    for (size_t at = 0; at + 8 <= size; at += 8) {
        uint64_t word;
        memcpy(&word, content + at, 8);
        factor += GOLDEN;
        sum += word * (factor | 1);
    }
    return sum;
}

static loewner_status map(File *file, const char *path)
{
    int descriptor = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (descriptor < 0)
        return fail(LOEWNER_BAD_FILE, "%.300s: could not be opened (%s)", path, strerror(errno));
    struct stat status;
    loewner_status outcome = LOEWNER_OK;
    if (fstat(descriptor, &status) != 0 || !S_ISREG(status.st_mode))
        outcome = fail(LOEWNER_BAD_FILE, "%.300s: expected a regular file, found another kind", path);
    else if (status.st_size < FILE_HEADER)
        outcome = fail(LOEWNER_BAD_FILE, "%.300s: expected a file that loewner saved, found another", path);
    else {
        file->size = (size_t)status.st_size;
        file->map = mmap(NULL, file->size, PROT_READ, MAP_PRIVATE, descriptor, 0);
        if (file->map == MAP_FAILED) {
            file->map = NULL;
            outcome = fail(LOEWNER_BAD_FILE, "%.300s: could not be mapped (%s)", path, strerror(errno));
        }
    }
    close(descriptor);
    return outcome;
}

static loewner_status read_header(const File *file, const char *path, Counts *counts)
{
    const char *content = file->map;
    struct { uint64_t format, size, checksum; } header;
    uint64_t numbers[sizeof *counts / sizeof(uint64_t)];
    if (memcmp(content, MAGIC, 8) != 0)
        return fail(LOEWNER_BAD_FILE, "%.300s: expected a file that loewner saved, found another", path);
    memcpy(&header, content + 8, sizeof header);
    memcpy(numbers, content + 32 + SOURCES_LENGTH, sizeof numbers);
    if (header.format != FILE_FORMAT || memcmp(content + 32, SOURCES, SOURCES_LENGTH) != 0)
        return fail(LOEWNER_OTHER_VERSION,
                    "%.300s: expected a file of format %d for kernels %.8s, found one of format %llu for kernels %.8s; "
                    "save it again with the loewner that this library belongs to",
                    path, FILE_FORMAT, SOURCES, (unsigned long long)header.format, content + 32);
    EXPECT(header.size == file->size && file->size % CACHE_LINE == 0, "its size is not the one in its header");
    EXPECT(header.checksum == checksum(content + BEHIND_CHECKSUM, file->size - BEHIND_CHECKSUM),
           "its checksum differs");
    for (size_t k = 0; k < sizeof numbers / sizeof *numbers; k++)
        EXPECT(numbers[k] < (uint64_t)MOST, "a count in its header");
    memcpy(counts, numbers, sizeof *counts);
    EXPECT((counts->has_cut == 0 || counts->has_cut == CUTTINGS - 1) &&
               counts->arrays == FILE_PACKS + PACK_ARRAYS * (1 + counts->has_cut) + SURFACE_ARRAYS * counts->surfaces,
           "the number of its arrays");
    EXPECT(counts->arrays <= (int64_t)(file->size / 32), "the number of its arrays");
    EXPECT(FILE_HEADER + 32 * counts->arrays <= (int64_t)file->size, "its directory");
    return LOEWNER_OK;
}

/* Look up an array by its number in the directory, and check its type and shape; if `rows` is -1, any number of rows is
   allowed. Write the array's address to `data`, and its number of rows to `count` unless `count` is NULL. */
static loewner_status take(const File *file, int64_t number, int64_t type, int64_t rows, int64_t columns,
                           const char *name, const void *data, int64_t *count)
{
    struct { int64_t type, rows, columns, at; } entry;
    memcpy(&entry, (const char *)file->map + FILE_HEADER + 32 * number, sizeof entry);
    EXPECT(0 <= entry.type && entry.type <= BYTES && 0 <= entry.rows && entry.rows < MOST && 0 <= entry.columns &&
               entry.columns < MOST && (entry.columns == 0 || entry.rows <= MOST / entry.columns),
           "its directory");
    int64_t bytes = entry.rows * entry.columns * item_sizes[entry.type], size = (int64_t)file->size;
    EXPECT(entry.at % CACHE_LINE == 0 && FILE_HEADER + 32 <= entry.at && entry.at <= size && bytes <= size - entry.at,
           "its directory");
    EXPECT(entry.type == type && entry.columns == columns && (rows < 0 || entry.rows == rows), name);
    const void *found = (const char *)file->map + entry.at;
    memcpy((void *)data, &found, sizeof found);
    if (count != NULL)
        *count = entry.rows;
    return LOEWNER_OK;
}

/* Which numbers an array may hold. */
typedef enum { ANY, NOT_NAN, FINITE } Allowed;

/* Return whether an array of singles or doubles holds only allowed numbers. */
static int are_allowed(const void *numbers, int64_t type, int64_t count, Allowed allowed)
{
    const double *doubles = numbers;
    const float *singles = numbers;
    int is = 1;
    for (int64_t k = 0; allowed != ANY && k < count; k++) {
        double number = type == SINGLES ? singles[k] : doubles[k];
        is &= allowed == FINITE ? isfinite(number) != 0 : !isnan(number);
    }
    return is;
}

/* The type and the number of columns that an array of a pack or a surface must have, the array's name for error
   messages, and the numbers that it may hold. The number of rows is checked later. */
typedef struct {
    int64_t type, columns;
    const char *name;
    Allowed allowed;
} Kind;

/* Look up consecutive arrays, beginning with the number `at`, and check each array against its kind. */
static loewner_status take_arrays(const File *file, int64_t at, const Kind *kinds, int count, Array2 *arrays)
{
    for (const Kind *kind = kinds; kind < kinds + count; kind++, at++, arrays++) {
        TRY(take(file, at, kind->type, -1, kind->columns, kind->name, &arrays->data, &arrays->rows));
        arrays->columns = kind->columns;
        EXPECT(are_allowed(arrays->data, kind->type, arrays->rows * kind->columns, kind->allowed),
               kind->allowed == FINITE ? "numbers that are not finite" : kind->name);
    }
    return LOEWNER_OK;
}

static int is_within(const int64_t *numbers, int64_t count, int64_t least, int64_t beyond)
{
    int is = 1;
    for (int64_t k = 0; k < count; k++)
        is &= least <= numbers[k] && numbers[k] < beyond;
    return is;
}

/* Return whether the starts of ranges begin with 0, never decrease, and end with a total. */
static int rises(const int64_t *starts, int64_t count, int64_t total)
{
    int is = starts[0] == 0 && starts[count - 1] == total;
    for (int64_t k = 1; k < count; k++)
        is &= starts[k - 1] <= starts[k] && starts[k] <= total;
    return is;
}

/* -- packs --------------------------------------------------------------------------------------------------------- */

static void leave_bytes(int8_t **bytes)
{
    free(*bytes);
}

/* Check the nodes of a large hull (see `directions.py`), which are stored after its vertices. Each node consists of two
   numbers, and all nodes together of `room` numbers. */
static loewner_status check_nodes(const double *nodes, int64_t room, int64_t vertices)
{
    int64_t count = room / 2;
    int8_t *depth __attribute__((cleanup(leave_bytes))) = NULL;
    EXPECT(count >= 6, "points: nodes");
    TRY(allocate(&depth, (size_t)count));
    memset(depth, -1, (size_t)count);
    memset(depth, 0, 6);
    for (int64_t k = 0; k < count; k++) {
        if (depth[k] < 0)
            continue; /* No node leads to this node. */
        double first = nodes[2 * k], last = nodes[2 * k + 1];
        if (last >= 0) {
            EXPECT(0 <= first && first < last && last <= (double)vertices && fmod(first, POINT_BLOCK) == 0 &&
                       fmod(last, POINT_BLOCK) == 0,
                   "points: nodes");
            continue;
        }
        /* Children must come after their parents, so that every walk through the nodes ends. */
        EXPECT((double)k < first && first <= (double)(count - 4) && depth[k] < DEEPEST, "points: nodes");
        for (int64_t child = (int64_t)first; child < (int64_t)first + 4; child++)
            if (depth[child] <= depth[k])
                depth[child] = (int8_t)(depth[k] + 1);
    }
    return LOEWNER_OK;
}

static loewner_status check_pieces(const struct pieces *pack, int64_t surfaces)
{
    const int64_t *row = pack->layout.data;
    const double *points = pack->points.data;
    int64_t pieces = pack->layout.rows, columns = pack->points.rows / 3, before = 0;
    for (int64_t p = 0; p < pieces; p++, row += LAYOUT) {
        int64_t kind = row[KIND_OF], first = row[POINTS_FROM], last = row[POINTS_TO], at = row[SURFACE_AT];
        int64_t next = p + 1 < pieces ? row[LAYOUT + POINTS_FROM] : columns;
        EXPECT(SOLID <= kind && kind <= LAST_KIND, "layout: kinds");
        EXPECT(before <= first && first <= last && last <= next && next <= columns, "layout: points");
        EXPECT(first % POINT_BLOCK == 0 && last % POINT_BLOCK == 0 && next % POINT_BLOCK == 0, "layout: points");
        EXPECT(kind <= SURFACE ? 1 <= at && at <= surfaces : at == 0, "layout: surfaces");
        EXPECT(kind > POLYTOPE || last > first, "layout: polytopes without points");
        if (kind == MAPPED)
            TRY(check_nodes(points + 3 * last, 3 * (next - last), last - first));
        before = next;
    }
    return LOEWNER_OK;
}

/* Check the trees over the pieces of bodies: the groups of a body must be stored one after another, and their children
   must be groups or pieces of the same body. */
static loewner_status check_trees(const struct pieces *pack)
{
    const int64_t *roots = pack->roots.data, *starts = pack->piece_start.data, *children = pack->children.data;
    int64_t begin = 0, groups = pack->groups.rows / GROUP_NUMBERS;
    int8_t *height __attribute__((cleanup(leave_bytes))) = NULL;
    TRY(allocate(&height, 2 * (size_t)groups + 1));
    int8_t *has_parent = height + groups;
    for (int64_t b = 0; b < pack->roots.rows; b++) {
        int64_t root = roots[b], first = starts[b], last = starts[b + 1];
        if (root == -1)
            continue;
        EXPECT(last - first > 1 && root < groups && root == begin + groups_of(last - first) - 1, "trees");
        for (int64_t c = WIDE * begin; c < WIDE * (root + 1); c++) {
            int64_t child = children[c], group = c / WIDE;
            if (child < 0) { /* An unused place contains -1. */
                EXPECT(child == -1 || (first <= ~child && ~child < last), "trees");
                continue;
            }
            /* Each group must have only one parent: otherwise, a walk would visit the group again for each path that
               leads to it. */
            EXPECT(begin <= child && child < group && !has_parent[child], "trees");
            has_parent[child] = 1;
            if (height[group] <= height[child])
                height[group] = (int8_t)(height[child] + 1);
            EXPECT(height[group] < TREE_LEVELS, "trees");
        }
        begin = root + 1;
    }
    EXPECT(begin == groups, "trees");
    return LOEWNER_OK;
}

static const Kind pack_kinds[PACK_ARRAYS] = {
    {DOUBLES, COLUMNS, "table", FINITE}, {INTEGERS, LAYOUT, "layout", ANY},  {DOUBLES, 1, "points", FINITE},
    {INTEGERS, 1, "piece_start", ANY},   {DOUBLES, HOT, "hot", FINITE},      {SINGLES, HOT, "single", FINITE},
    {DOUBLES, 1, "groups", NOT_NAN},     {INTEGERS, 1, "children", ANY},     {INTEGERS, 1, "roots", ANY},
    {SINGLES, 1, "vertices", FINITE},    {DOUBLES, HOT, "parts", FINITE},    {INTEGERS, 1, "part_start", ANY},
};

static loewner_status take_pack(const File *file, int64_t at, int64_t surfaces, struct pieces *pack)
{
    TRY(take_arrays(file, at, pack_kinds, PACK_ARRAYS, (Array2 *)pack));
    int64_t bodies = file->bodies, pieces = pack->table.rows, numbers = pack->points.rows, singles = pack->single.rows;
    int64_t groups = pack->groups.rows, vertices = pack->vertices.rows, starts = pack->part_start.rows;
    EXPECT(pack->layout.rows == pieces, "layout");
    EXPECT(pack->piece_start.rows == bodies + 1, "piece_start");
    EXPECT(pack->hot.rows == pieces, "hot");
    EXPECT(pack->roots.rows == bodies, "roots");
    EXPECT(numbers % (3 * POINT_BLOCK) == 0, "points");
    EXPECT(groups % GROUP_NUMBERS == 0 && pack->children.rows == WIDE * (groups / GROUP_NUMBERS), "groups");
    EXPECT(singles == 0 || singles == pieces, "single");
    EXPECT(vertices == (singles > 0 ? numbers : 0), "vertices");
    EXPECT(starts == 0 || starts == PARTS * pieces, "part_start");
    const int64_t *start = pack->piece_start.data, *layout = pack->layout.data, *part_start = pack->part_start.data;
    EXPECT(rises(start, bodies + 1, pieces), "piece_start");
    for (int64_t b = 0; b < bodies; b++)
        EXPECT(start[b] < start[b + 1], "a body without pieces");
    for (int64_t p = 0; p < starts / PARTS; p++) {
        const int64_t *row = part_start + PARTS * p;
        EXPECT(0 <= row[0] && row[0] <= row[1] && row[1] <= row[2] && row[2] <= pack->parts.rows, "part_start");
        EXPECT(layout[LAYOUT * p + KIND_OF] <= SURFACE ? row[0] < row[2] : row[2] == 0, "part_start");
    }
    TRY(check_pieces(pack, surfaces));
    return check_trees(pack);
}

static const Kind surface_kinds[SURFACE_ARRAYS] = {
    {SINGLES, 1, "boxes of a surface", NOT_NAN}, {INTEGERS, 1, "children of a surface", ANY},
    {DOUBLES, 1, "blocks of a surface", FINITE}, {DOUBLES, 1, "parts of a surface", FINITE},
    {SINGLES, 1, "diagonals of a surface", NOT_NAN},
};

/* Look up the arrays of a surface, and check the tree over its triangles (see `triangle_tree.py`). */
static loewner_status take_surface(const File *file, int64_t at, Surface *surface)
{
    TRY(take_arrays(file, at, surface_kinds, SURFACE_ARRAYS, (Array2 *)surface));
    const float *boxes = surface->boxes.data;
    const int64_t *children = surface->children.data;
    int64_t places = surface->children.rows, nodes = places / WIDE_SURFACE, numbers = surface->blocks.rows;
    int64_t leaves = numbers / BLOCK_NUMBERS;
    EXPECT(nodes >= 1 && leaves >= 1 && places % WIDE_SURFACE == 0 && numbers % BLOCK_NUMBERS == 0 &&
               surface->boxes.rows == 6 * WIDE_SURFACE * nodes && surface->parts.rows % 3 == 0 &&
               surface->diagonals.rows == DIAGONAL_NUMBERS * nodes,
           "a surface");
    int8_t *depth __attribute__((cleanup(leave_bytes))) = NULL;
    TRY(allocate(&depth, (size_t)nodes));
    for (int64_t s = 0; s < places; s++) {
        int64_t child = children[s], node = s / WIDE_SURFACE;
        if (child < 0) {
            EXPECT(~child >> LEAF_BITS < leaves, "children of a surface");
            continue;
        }
        if (child == 0) { /* The place is unused: its box must be empty, so that no walk opens it. */
            const float *half = boxes + 6 * WIDE_SURFACE * node + 3 * WIDE_SURFACE + s % WIDE_SURFACE;
            EXPECT(half[0] == -INFINITY && half[WIDE_SURFACE] == -INFINITY && half[2 * WIDE_SURFACE] == -INFINITY,
                   "children of a surface");
            continue;
        }
        /* This node must be the child's only parent. */
        EXPECT(node < child && child < nodes && depth[child] == 0 && depth[node] < SURFACE_LEVELS,
               "children of a surface");
        depth[child] = (int8_t)(depth[node] + 1);
    }
    return LOEWNER_OK;
}

/* In a copy of the layout, replace the numbers of surfaces with the addresses of their tables. */
static loewner_status link_surfaces(File *file, Cutting cutting)
{
    Array2 *layout = &file->packs[cutting].layout;
    if (file->surfaces == NULL || layout->rows == 0)
        return LOEWNER_OK;
    size_t size = sizeof(int64_t) * LAYOUT * (size_t)layout->rows;
    TRY(allocate(&file->owned[cutting], size));
    int64_t *copy = memcpy(file->owned[cutting], layout->data, size);
    for (int64_t *at = copy + SURFACE_AT; at < copy + LAYOUT * layout->rows; at += LAYOUT)
        if (*at != 0)
            *at = (int64_t)(file->surfaces + *at - 1);
    layout->data = copy;
    return LOEWNER_OK;
}

/* -- robots -------------------------------------------------------------------------------------------------------- */

static const int64_t widths[] = {0, 1, 1, 3, 7, 4}; /* Number of values of a joint of each kind in `columns.py`. */

static loewner_status take_robot(File *file)
{
    Tree *tree = &file->tree;
    int64_t links = file->links, dof = file->dof, moving = file->moving, bodies = file->bodies;
    TRY(take(file, FILE_PARENT, INTEGERS, links, 1, "parent", &tree->parent, NULL));
    TRY(take(file, FILE_KIND, INTEGERS, links, 1, "kind", &tree->kind, NULL));
    TRY(take(file, FILE_COLUMN, INTEGERS, links, 1, "column", &tree->column, NULL));
    TRY(take(file, FILE_MULTIPLIER, DOUBLES, links, 1, "multiplier", &tree->multiplier, NULL));
    TRY(take(file, FILE_OFFSET, DOUBLES, links, 1, "offset", &tree->offset, NULL));
    TRY(take(file, FILE_CONSTANTS, DOUBLES, links, LINK_CONSTANTS, "constants", &tree->constants, NULL));
    TRY(take(file, FILE_LIMITS, DOUBLES, 5, dof, "limits", &file->limits, NULL));
    TRY(take(file, FILE_JOINTS, INTEGERS, dof, 1, "joints", &file->joints, NULL));
    TRY(take(file, FILE_QUATERNIONS, INTEGERS, -1, 1, "quaternions", &file->quaternions, &file->quaternion_count));
    TRY(take(file, FILE_LINK, INTEGERS, moving, 1, "link", &file->link, NULL));
    TRY(take(file, FILE_PAIRS, INTEGERS, -1, 2, "pairs", &file->pair_list, &file->pairs));
    TRY(take(file, FILE_MARGINS, DOUBLES, file->pairs, 1, "margins", &file->margins, NULL));
    TRY(take(file, FILE_ORDER, INTEGERS, file->pairs, 1, "order", &file->order, NULL));
    TRY(take(file, FILE_POSES, DOUBLES, bodies - moving, 16, "poses", &file->poses, NULL));
    TRY(take(file, FILE_OWN, DOUBLES, bodies, 1, "own", &file->own, NULL));
    TRY(take(file, FILE_LOWERED, INTEGERS, bodies, 1, "lowered", &file->lowered, NULL));
    TRY(take(file, FILE_RULES, INTEGERS, -1, 3, "rules", &file->rules, &file->rule_count));
    TRY(take(file, FILE_RULE_MARGINS, DOUBLES, file->rule_count, 1, "rule_margins", &file->rule_margins, NULL));
    for (int64_t k = 0; k < bodies; k++)
        EXPECT(file->own[k] >= 0 && file->own[k] <= 1e30, "own");
    for (int64_t k = 0; k < file->rule_count; k++) {
        const int64_t *rule = file->rules + 3 * k;
        EXPECT(moving <= rule[0] && rule[0] < rule[1] && rule[1] < bodies && (rule[2] == 0 || rule[2] == 1), "rules");
        EXPECT(file->rule_margins[k] == -1 || (file->rule_margins[k] >= 0 && file->rule_margins[k] <= 1e30), "rules");
    }
    tree->links = links;
    for (int64_t k = 0; k < links; k++) {
        int64_t kind = tree->kind[k];
        EXPECT(-1 <= tree->parent[k] && tree->parent[k] < k && 0 <= kind && kind <= BALL, "parent, kind");
        EXPECT(0 <= tree->column[k] && tree->column[k] <= dof - widths[kind], "column");
    }
    EXPECT(are_allowed(tree->multiplier, DOUBLES, links, FINITE) && are_allowed(tree->offset, DOUBLES, links, FINITE) &&
               are_allowed(tree->constants, DOUBLES, LINK_CONSTANTS * links, FINITE),
           "numbers that are not finite");
    for (int64_t k = 0; k < 5 * dof; k++)
        EXPECT(!isnan(file->limits[k]) && (k < 4 * dof || file->limits[k] > 0), "limits");
    EXPECT(dof < 4096 && links < 4096, "the size of the robot");
    EXPECT(is_within(file->joints, dof, 0, 16) && is_within(file->quaternions, file->quaternion_count, 0, dof - 3) &&
               is_within(file->link, moving, 0, links) && is_within(file->order, file->pairs, 0, file->pairs),
           "indices");
    for (int64_t k = 0; k < file->pairs; k++) {
        const int64_t *pair = file->pair_list + 2 * k;
        EXPECT(0 <= pair[0] && pair[0] < moving && pair[0] < pair[1] && pair[1] < bodies, "pairs");
        /* Pairs must be in ascending order, because searches rely on this order. */
        EXPECT(k == 0 || pair[-2] < pair[0] || (pair[-2] == pair[0] && pair[-1] < pair[1]), "pairs");
        EXPECT(file->margins[k] >= 0 && file->margins[k] <= 1e30, "margins");
    }
    return LOEWNER_OK;
}

/* Read the names, which are stored one after another, each terminated by a zero byte. */
static loewner_status take_names(File *file, int64_t count)
{
    const char *text;
    int64_t size, found = 0, begin = 0;
    TRY(take(file, FILE_NAMES, BYTES, -1, 1, "names", &text, &size));
    EXPECT(count <= size, "names");
    TRY(allocate(&file->names, sizeof(char *) * (size_t)(count + 1)));
    for (int64_t k = 0; k < size; k++)
        if (text[k] == '\0') {
            EXPECT(found < count, "names");
            file->names[found++] = text + begin;
            begin = k + 1;
        }
    EXPECT(found == count && begin == size, "names");
    return LOEWNER_OK;
}

static loewner_status read_file(File *file, const char *path)
{
    Counts counts = {0};
    int64_t margins, at = FILE_PACKS;
    const double *margin;
    TRY(map(file, path));
    TRY(read_header(file, path, &counts));
    file->dof = counts.dof;
    file->links = counts.links;
    file->moving = counts.moving;
    file->bodies = counts.moving + counts.standing;
    file->has_cut = (int)counts.has_cut;
    EXPECT(file->bodies <= INT32_MAX && file->links <= INT32_MAX && file->dof <= INT32_MAX, "a count in its header");
    TRY(take_names(file, file->bodies + file->links + file->dof));
    TRY(take(file, FILE_MARGIN, DOUBLES, -1, 1, "margin", &margin, &margins));
    EXPECT(margins <= 1, "margin");
    file->margin = margins == 1 ? *margin : 0;
    EXPECT(file->margin >= 0 && file->margin <= 1e30, "margin");
    if (file->links > 0)
        TRY(take_robot(file));
    else
        EXPECT(file->dof == 0 && file->moving == 0, "a robot without links");
    for (int k = 0; k <= file->has_cut; k++, at += PACK_ARRAYS)
        TRY(take_pack(file, at, counts.surfaces, file->packs + k));
    if (counts.surfaces > 0) {
        TRY(allocate(&file->surfaces, sizeof(Surface) * (size_t)counts.surfaces));
        for (int64_t k = 0; k < counts.surfaces; k++, at += SURFACE_ARRAYS)
            TRY(take_surface(file, at, file->surfaces + k));
    }
    for (int k = 0; k < CUTTINGS; k++)
        TRY(link_surfaces(file, k));
    return LOEWNER_OK;
}

/* -- files --------------------------------------------------------------------------------------------------------- */

loewner_status open_file(const char *path, File **made)
{
    File *file;
    TRY(allocate(&file, sizeof *file));
    atomic_init(&file->users, 1);
    opened_path = path;
    loewner_status outcome = read_file(file, path);
    if (outcome == LOEWNER_OK)
        *made = file;
    else
        leave_file(file);
    return outcome;
}

void leave_file(File *file)
{
    if (file == NULL || atomic_fetch_sub(&file->users, 1) != 1)
        return;
    for (int k = 0; k < CUTTINGS; k++)
        free(file->owned[k]);
    free(file->surfaces);
    free(file->names);
    if (file->map != NULL)
        munmap(file->map, file->size);
    free(file);
}

/* -- bodies -------------------------------------------------------------------------------------------------------- */

loewner_status loewner_bodies_open(const char *path, loewner_bodies **bodies)
{
    REQUIRE(path != NULL && bodies != NULL, "path, bodies: expected pointers, found NULL");
    *bodies = NULL;
    if (kernels() == NULL)
        return LOEWNER_NO_KERNELS;
    return open_file(path, bodies);
}

void loewner_bodies_close(loewner_bodies *bodies)
{
    leave_file(bodies);
}

int64_t loewner_bodies_count(const loewner_bodies *bodies)
{
    return bodies == NULL ? 0 : bodies->bodies;
}
