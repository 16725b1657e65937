/* Shared by the files of `libloewner`; programs include `loewner.h` only.

   kernels.c   finds the machine code beside the library        files.c     maps files and checks them
   scene.c     bodies, pairs and poses of a checker, as kernels take them
   queries.c   configurations and motions                       plans.c     paths
   gate.c      chunks of targets in a control loop              pairs.c     pairs of bodies, without a checker */

#ifndef LOEWNER_INTERNAL_H
#define LOEWNER_INTERNAL_H

#include "loewner.h"

#include "kernels.h"

#include <pthread.h>
#include <stdatomic.h>

/* Set the text of this thread's last error; returns the status. */
loewner_status fail(loewner_status status, const char *format, ...) __attribute__((format(printf, 2, 3)));
loewner_status no_memory(void);

#define TRY(call)                                                                                                      \
    do {                                                                                                               \
        loewner_status status_ = (call);                                                                               \
        if (status_ != LOEWNER_OK)                                                                                     \
            return status_;                                                                                            \
    } while (0)

/* -- kernels: see `loewner/_native/entries.py` --------------------------------------------------------------------- */

typedef int32_t (*Kernel)(const int64_t *, int64_t *);

typedef struct {
#define DECLARE(name) Kernel name;
    ALL_KERNELS(DECLARE)
#undef DECLARE
    void (*release)(void *);
    const char *level;
    int64_t settle_memory, distance_memory; /* bytes */
} Kernels;

/* The kernels of this machine, loaded at the first call; NULL, with an error, if there are none. */
const Kernels *kernels(void);

/* Settle pairs; in mode EXACT, also the pairs that the fast searches leave open. Write whether all poses are rigid. */
loewner_status settle_all(const struct settle_range *asked, int *are_rigid);

/* Write result k of n kernels' distances: bounds, values (NaN: none), and vectors, shape (3, n, 3). */
void write_distance(loewner_distance *found, const double *lower, const double *upper, const double *values,
                    const double *vectors, int64_t n, int64_t k, int is_settled);

/* Call a kernel with the address of a struct of slots; kernels fail only where memory is short. */
loewner_status call(Kernel kernel, const void *arguments, void *results);

/* Call a kernel with its arguments by their names; omitted ones are 0. Pass NULL if there are no results. */
#define CALL(name, results, ...) call(kernels()->name, &(const struct name){__VA_ARGS__}, results)

/* -- packs: bodies as kernels take them, see `loewner/_kernels/pieces/shapes.py` ----------------------------------- */

enum { PACK_ARRAYS = sizeof(struct pieces) / sizeof(Array2) };

typedef struct {
    int64_t bodies, pieces, numbers, groups, parts; /* `numbers` of `points` */
    int is_single, has_parts;
    const double *table;
    const int64_t *layout;
    const double *points;
    const int64_t *piece_start;
    const double *hot;
    const float *single;
    const double *tree_groups;
    const int64_t *children, *roots;
    const float *vertices;
    const double *part_rows;
    const int64_t *part_start;
} Pack;

/* Number of groups in the tree over the pieces of a body, if it has one. */
static inline int64_t groups_of(int64_t pieces)
{
    int64_t total = 0;
    while (pieces > 1) {
        pieces = (pieces + WIDE - 1) / WIDE;
        total += pieces;
    }
    return total;
}

/* The table of addresses to which a handle points. */
struct pieces table_of(const Pack *pack);

/* -- files --------------------------------------------------------------------------------------------------------- */

typedef struct {
    int64_t links;
    const int64_t *parent, *kind, *column;
    const double *multiplier, *offset, *constants;
} Tree;

enum { SURFACE_ARRAYS = 5 };

/* Which surfaces are in parts: none; all; or surfaces of static bodies without solids, in small parts. */
typedef enum { WHOLE, CUT, OPEN_CUT, CUTTINGS } Cutting;

typedef struct {
    atomic_int users;
    void *map;
    size_t size;
    void *owned[CUTTINGS]; /* copies of layouts, with addresses of surfaces */
    Array2 *surfaces;      /* SURFACE_ARRAYS of each */
    int64_t dof, links, moving, bodies, pairs;
    int has_cut;
    const char **names; /* of bodies, links and values */
    Tree tree;
    const double *limits; /* lower, upper; the same without soft limits; velocity */
    const int64_t *joints; /* bits: JOINT_... */
    const int64_t *quaternions;
    int64_t quaternion_count;
    const int64_t *link, *pair_list, *order;
    const double *margins, *poses;
    double margin;
    const double *own;              /* margins of single bodies */
    const int64_t *lowered, *rules; /* rules of pairs of static bodies: two bodies, and whether they may touch */
    const double *rule_margins;     /* -1 for none */
    int64_t rule_count;
    Pack packs[CUTTINGS]; /* without cuts only the first one */
} File;

enum { JOINT_SINGLE = 1, JOINT_NO_LOWER = 2, JOINT_NO_UPPER = 4, JOINT_TURNING = 8 };

loewner_status open_file(const char *path, File **file);
void leave_file(File *file);

struct loewner_bodies {
    File *file;
};

/* -- checkers ------------------------------------------------------------------------------------------------------ */

/* The tables of a problem: kernels for motions take the address of the second one, too. */
typedef struct {
    struct problem problem;
    struct motion_tables motions;
} Tables;

typedef struct {
    char *name;
    File *file;
    int64_t which;
    int64_t link; /* of the robot; -1 for a body of the scene */
    int is_attached, is_present;
    double pose[16]; /* in the world, or in the frame of the link */
    int has_bounds;
    loewner_bounds bounds;
    int32_t *touch;
    size_t touch_count;
} Body;

/* Settings of a user for a pair. */
typedef struct {
    int64_t a, b;  /* a < b */
    int64_t touch; /* whether they may; -1 if the file decides */
    double margin; /* -1 if the file decides */
} Rule;

/* All that kernels are given of one set of bodies. */
typedef struct {
    struct pieces pieces; /* the table of the bodies */
    double *block;
    int64_t block_words;
    int64_t handle, motions;
    int64_t memory; /* bytes that any query writes to */
} Half;

/* The pairs to check, derived from the bodies and the rules. */
typedef struct {
    int64_t moving, attached, standing, pairs; /* attached bodies move */
    int64_t growing; /* bodies with bounds */
    int has_cut, starts_matter, is_as_saved; /* the last: bodies and pairs are the file's, and its arrays are used */
    int32_t *body;  /* the body at each place: first the moving ones */
    int32_t *place; /* of a body, -1 if it is absent */
    Tree tree;      /* with a link for each attached body */
    int64_t *link, *pair_list, *rows, *order;
    double *margins, *poses;
    Half halves[CUTTINGS]; /* without a block, a half is missing, and `half_of` returns the first one */
    void *memory[32];
    int memory_count;
} State;

struct loewner_checker {
    File *file;
    Body *bodies;
    int32_t body_count;
    Rule *rules;
    size_t rule_count;
    pthread_mutex_t lock;
    atomic_int is_stale; /* 1: poses; 2: all */
    uint64_t serial;     /* of the state: different for each state, even of other checkers */
    State state;
};

struct loewner_workspace {
    atomic_flag is_used;
    uint64_t serial; /* of the state that it is prepared for */
    Tables tables; /* with the workspace's own order of the pairs */
    int64_t pack;
    int64_t *order, *hits, seen, next_look;
    char *memory; /* for kernels */
    char *validator;         /* for `free_motions`, which keeps an order of pairs in it from call to call */
    int64_t is_ready;        /* whether it keeps one */
    double *link_poses, *poses, *courses, *off, *fractions, *numbers, *vectors, *slopes;
    int64_t *found_pairs, *work, *pieces;
    int8_t *tiers, *pair_verdicts, *found;
    void *block;
    size_t size;
    double *path;
    size_t path_room;
};

/* Reserve a workspace until the calling function returns; in one workspace, two threads would get wrong answers. */
loewner_status take_workspace(loewner_workspace *workspace, loewner_workspace **held);

static inline void leave_workspace(loewner_workspace **held)
{
    if (*held != NULL)
        atomic_flag_clear_explicit(&(*held)->is_used, memory_order_release);
}

#define HOLD(workspace)                                                                                                \
    loewner_workspace *held __attribute__((cleanup(leave_workspace))) = NULL;                                          \
    TRY(take_workspace(workspace, &held))

/* Configurations and motions that are handled together. */
enum { CHUNK = 4096, MOTIONS_AT_ONCE = 64 };
enum { WORK = 3 }; /* numbers of a tally of `certify_motions`; the last one counts the steps */
#define TOLERANCE 1e-5 /* of proofs of motions, in metres, unless a caller gives another */

/* Take over changes of the scene, and prepare a workspace. */
loewner_status prepare(const loewner_checker *checker, loewner_workspace *workspace);

/* Prepare for queries that do not support bounds: refuse bodies with bounds. */
loewner_status prepare_exact(const loewner_checker *checker, loewner_workspace *workspace);

/* The bodies with some of their surfaces cut, or whole where there is nothing to cut. */
const Half *half_of(const loewner_checker *checker, Cutting cutting);

loewner_status check_configurations(const loewner_checker *checker, const double *configurations, size_t n,
                                    const char *name);
loewner_status check_poses(const double *poses, size_t n, const char *name);

/* Refuse numbers of rows, of some doubles each, whose size in bytes would wrap around and pass for a small one. */
loewner_status check_count(size_t n, size_t doubles, const char *name);

/* Verdicts of configurations that were checked. In the mode HASTY, which allocates nothing, configurations that the fast
   searches leave open stay AMBIGUOUS. */
enum { HASTY = -1 };
loewner_status collide(const loewner_checker *checker, loewner_workspace *workspace, int mode,
                       const double *configurations, size_t n, int8_t *verdicts);

/* The verdict on one configuration, which was checked, and the first pair that has it; -1 if all pairs are free. */
loewner_status worst_pair(const loewner_checker *checker, loewner_workspace *workspace, const double *q,
                          int8_t *verdict, int64_t *pair);

/* Prove motions by their control points, shape (n, degree + 1, dof), which were checked; n <= MOTIONS_AT_ONCE.
   `fractions` and `pairs` have room for n. `t0` and `t1`, shape (n,), may be NULL. Each motion may take `steps`, and
   row k of `workspace->work` receives its poses, searches and steps. */
loewner_status prove(const loewner_checker *checker, loewner_workspace *workspace, double *courses, size_t n,
                     int32_t degree, double tolerance, const double *joint_error, const double *t0, const double *t1,
                     int64_t steps, int8_t *verdicts, double *fractions, int64_t *pairs);

/* Let the kernel prove courses, and confirm nothing. The rows of `off`, with `width` numbers, are errors of the values
   and then of bodies; COLLIDING counts these as margins, unless `as_given`. Each course may take `steps`, and `work`,
   shape (count, WORK), receives its work. */
loewner_status certify(const loewner_checker *checker, loewner_workspace *workspace, double *courses, int64_t count,
                       int64_t points, double *off, int64_t width, double tolerance, int64_t as_given, int64_t steps,
                       int64_t *work, int8_t *verdicts, double *fractions, int64_t *pairs);

/* Write the errors of the values of a course (`joint_error` may be NULL) and of bodies with bounds from t0 to t1, where
   these times have an error of `late`; the row has dof + 3 growing numbers. */
void write_off(const loewner_checker *checker, const double *course, int64_t points, const double *joint_error,
               double t0, double t1, double late, double *row);

/* The configuration of a course at a fraction. */
void evaluate(const File *file, const double *course, int32_t degree, double t, double *q);

/* Write the course of the straight motion from a to b, shape (2, dof). */
void straight(const loewner_checker *checker, const double *a, const double *b, double *course);

#endif
