/* Declarations that the files of `libloewner` share; programs include only `loewner.h`.

   kernels.c   finds the machine code next to the library        files.c     maps files and checks them
   scene.c     bodies, pairs and poses of a checker, as kernels take them
   queries.c   configurations and motions                       plans.c     paths
   gate.c      chunks of targets in a control loop              pairs.c     pairs of bodies, without a checker */

#ifndef LOEWNER_INTERNAL_H
#define LOEWNER_INTERNAL_H

#include "loewner.h"

#include "kernels.h"

#include <pthread.h>
#include <stdatomic.h>

/* Set the text of this thread's last error; return the status. */
loewner_status fail(loewner_status status, const char *format, ...) __attribute__((format(printf, 2, 3)));
loewner_status no_memory(void);

/* Write the address of new memory, all zero, to a field. */
loewner_status allocate(void *field, size_t size);

/* Resize the memory whose address is in a field, and write its new address; the field may hold NULL. */
loewner_status enlarge(void *field, size_t size);

#define TRY(call)                                                                                                      \
    do {                                                                                                               \
        loewner_status status_ = (call);                                                                               \
        if (status_ != LOEWNER_OK)                                                                                     \
            return status_;                                                                                            \
    } while (0)

/* Refuse an argument that does not meet a condition; a message with its values follows. */
#define REQUIRE(condition, ...)                                                                                        \
    do {                                                                                                               \
        if (!(condition))                                                                                              \
            return fail(LOEWNER_BAD_ARGUMENT, __VA_ARGS__);                                                            \
    } while (0)

/* -- kernels: see `loewner/_native/entries.py` --------------------------------------------------------------------- */

typedef int32_t (*Kernel)(const int64_t *, int64_t *);

typedef struct {
#define DECLARE(name) Kernel name;
    ALL_KERNELS(DECLARE)
#undef DECLARE
    void (*release)(void *);
    const char *level;
    int64_t settle_memory, distance_memory; /* Numbers of bytes. */
} Kernels;

/* Return the kernels of this machine, which are loaded at the first call; NULL, with an error, if none exist. */
const Kernels *kernels(void);

/* Return how many elements are handled together when n are left. */
static inline size_t at_most(size_t n, size_t most)
{
    return n < most ? n : most;
}

/* Return a number of bytes, rounded up to whole cache lines. */
static inline size_t in_lines(size_t bytes)
{
    return (bytes + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
}

/* A part of a block of memory: the field for its address, and its number of bytes. */
typedef struct {
    void **field;
    size_t size;
} Part;

/* Write the addresses of the parts of a block, unless the block is NULL; return the size of the block. */
size_t divide(void *block, const Part *parts, size_t count);

/* Settle pairs; in mode EXACT, also settle the pairs that the fast searches leave open. Write whether all poses are
   rigid. */
loewner_status settle_all(const struct settle_range *asked, int *are_rigid);

/* Write result k of the distances that kernels computed for n pairs: bounds, values (NaN for no value), and vectors,
   shape (3, n, 3). */
void write_distance(loewner_distance *found, const double *lower, const double *upper, const double *values,
                    const double *vectors, int64_t n, int64_t k, int is_settled);

/* Call a kernel with the address of a struct of slots. Kernels fail only if memory runs out. */
loewner_status call(Kernel kernel, const void *arguments, void *results);

/* Call a kernel with named arguments; omitted arguments are 0. Pass NULL if the kernel has no results. */
#define CALL(name, results, ...) call(kernels()->name, &(const struct name){__VA_ARGS__}, results)

/* -- packs: bodies as kernels take them, see `loewner/_kernels/pieces/shapes.py` ----------------------------------- */

/* A pack is a `struct pieces`, which consists of arrays only. */
enum { PACK_ARRAYS = sizeof(struct pieces) / sizeof(Array2) };

/* Return the number of groups in the tree over this number of pieces, provided that the body has a tree. */
static inline int64_t groups_of(int64_t pieces)
{
    int64_t total = 0;
    while (pieces > 1) {
        pieces = (pieces + WIDE - 1) / WIDE;
        total += pieces;
    }
    return total;
}

/* -- files --------------------------------------------------------------------------------------------------------- */

typedef struct {
    int64_t links;
    const int64_t *parent, *kind, *column;
    const double *multiplier, *offset, *constants;
} Tree;

/* The arrays of a surface, see `triangle_tree.py`. */
typedef struct {
    Array2 boxes, children, blocks, parts, diagonals;
} Surface;

enum { SURFACE_ARRAYS = sizeof(Surface) / sizeof(Array2) };

/* Which surfaces are cut into parts: none (WHOLE), all (CUT), or the surfaces of static bodies that contain no solid,
   into small parts (OPEN_CUT). */
typedef enum { WHOLE, CUT, OPEN_CUT, CUTTINGS } Cutting;

/* A mapped file. The bodies that a program opens are such a file; the files of checkers also describe a robot. */
typedef struct loewner_bodies {
    atomic_int users;
    void *map;
    size_t size;
    void *owned[CUTTINGS]; /* Copies of layouts, with addresses of surfaces. */
    Surface *surfaces;
    int64_t dof, links, moving, bodies, pairs;
    int has_cut;
    const char **names; /* Names of bodies, links and values. */
    Tree tree;
    const double *limits; /* Rows: lower and upper limits, the same without soft limits, and velocity limits. */
    const int64_t *joints; /* Bits of each entry: JOINT_SINGLE and so on. */
    const int64_t *quaternions;
    int64_t quaternion_count;
    const int64_t *link, *pair_list, *order;
    const double *margins, *poses;
    double margin;
    const double *own;              /* Margins of single bodies. */
    /* Each rule is for a pair of static bodies: the two bodies, and whether they may touch. */
    const int64_t *lowered, *rules;
    const double *rule_margins;     /* -1 stands for no margin. */
    int64_t rule_count;
    struct pieces packs[CUTTINGS]; /* Without cuts, only the first pack is used. */
} File;

enum { JOINT_SINGLE = 1, JOINT_NO_LOWER = 2, JOINT_NO_UPPER = 4, JOINT_TURNING = 8 };

loewner_status open_file(const char *path, File **file);
void leave_file(File *file);

/* -- checkers ------------------------------------------------------------------------------------------------------ */

/* The tables of a problem. Kernels for motions also take the address of the second table. */
typedef struct {
    struct problem problem;
    struct motion_tables motions;
} Tables;

typedef struct {
    char *name;
    File *file;
    int64_t which;
    int64_t link; /* Link of the robot; -1 for a body of the scene. */
    int is_attached, is_present;
    double pose[16]; /* Pose in the world, or in the frame of the link. */
    int has_bounds;
    loewner_bounds bounds;
    int32_t *touch;
    size_t touch_count;
} Body;

/* Settings for a pair that a user made. */
typedef struct {
    int64_t a, b;  /* The smaller index comes first. */
    int64_t touch; /* Whether the bodies may touch; -1 if the file decides. */
    double margin; /* The margin is -1 if the file decides. */
} Rule;

/* Everything that kernels receive about one set of bodies. */
typedef struct {
    struct pieces pieces; /* The table of the bodies. */
    double *block;
    int64_t block_words;
    int64_t handle, motions;
    int64_t memory; /* Number of bytes to which any query writes. */
} Half;

/* The pairs to check, derived from the bodies and the rules. */
typedef struct {
    int64_t moving, attached, standing, pairs; /* Attached bodies are among the moving bodies. */
    int64_t growing; /* Number of bodies with bounds. */
    /* If `is_as_saved`, the bodies and pairs are the file's, and its arrays are used. */
    int has_cut, starts_matter, is_as_saved;
    int32_t *body;  /* The body at each place; moving bodies come first. */
    int32_t *place; /* The place of each body; -1 if the body is absent. */
    Tree tree;      /* The tree has a link for each attached body. */
    int64_t *link, *pair_list, *rows, *order;
    double *margins, *poses;
    Half halves[CUTTINGS]; /* Without cut surfaces, only the first half has a block, and `half_of` returns it. */
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
    atomic_int is_stale; /* 1 if poses are stale, 2 if everything is. */
    uint64_t serial;     /* The serial number is different for each state, even of other checkers. */
    State state;
};

struct loewner_workspace {
    atomic_flag is_used;
    const loewner_checker *checker; /* The checker in the current query, from `prepare` on. */
    uint64_t serial; /* Serial number of the state for which the workspace is prepared. */
    Tables tables; /* These tables have the workspace's own order of the pairs. */
    int64_t pack;
    int64_t *order, *hits, seen, next_look;
    char *memory; /* Memory for kernels. */
    char *validator;         /* Memory for `free_motions`, which keeps an order of pairs in it from call to call. */
    int64_t is_ready;        /* Whether `validator` holds an order of pairs. */
    double *link_poses, *poses, *courses, *off, *fractions, *numbers, *vectors, *slopes;
    int64_t *found_pairs, *work, *pieces;
    int8_t *tiers, *pair_verdicts, *found;
    void *block;
    size_t size;
    double *path;
    size_t path_room;
};

/* Reserve a workspace until the calling function returns; two threads in one workspace would get wrong answers. */
loewner_status take_workspace(loewner_workspace *workspace, loewner_workspace **held);

static inline void leave_workspace(loewner_workspace **held)
{
    if (*held != NULL)
        atomic_flag_clear_explicit(&(*held)->is_used, memory_order_release);
}

#define HOLD(workspace)                                                                                                \
    loewner_workspace *held __attribute__((cleanup(leave_workspace))) = NULL;                                          \
    TRY(take_workspace(workspace, &held))

/* Reserve a workspace, and prepare it by `prepare` or `prepare_exact`. */
#define HOLD_PREPARED(checker, workspace, prepare)                                                                     \
    HOLD(workspace);                                                                                                   \
    TRY(prepare(checker, workspace))

/* Numbers of configurations and motions that are handled together. */
enum { CHUNK = 4096, MOTIONS_AT_ONCE = 64 };
enum { WORK = 3 }; /* A tally of `certify_motions` has WORK numbers; the last one counts the steps. */
#define TOLERANCE 1e-5 /* Tolerance of proofs of motions in metres, unless the caller gives another tolerance. */

/* Give a workspace at least `size` bytes. Their content is lost, and the workspace has to be prepared again. */
loewner_status reserve(loewner_workspace *workspace, size_t size);

/* Apply changes of the scene, and prepare a workspace. */
loewner_status prepare(const loewner_checker *checker, loewner_workspace *workspace);

/* Prepare for queries that do not support bounds: refuse bodies with bounds. */
loewner_status prepare_exact(const loewner_checker *checker, loewner_workspace *workspace);

/* Return the bodies with some of their surfaces cut, or whole bodies if no surface can be cut. */
const Half *half_of(const loewner_checker *checker, Cutting cutting);

/* Write the bodies of a checked pair; -1 for no pair. */
void write_bodies(const State *state, int64_t pair, int32_t bodies[2]);

/* Refuse NULL as the address of n elements, unless n is 0. */
loewner_status expect_pointer(const void *pointer, size_t n, const char *name);

loewner_status check_configurations(const loewner_checker *checker, const double *configurations, size_t n,
                                    const char *name);
loewner_status check_poses(const double *poses, size_t n, const char *name);

/* Refuse a number of rows, each of several doubles, whose size in bytes would wrap around and pass for a small one. */
loewner_status check_count(size_t n, size_t doubles, const char *name);

/* Return the joint errors, or NULL if they are NULL or all 0. */
static inline const double *if_any(const double *errors, int64_t dof)
{
    for (int64_t c = 0; errors != NULL && c < dof; c++)
        if (errors[c] > 0)
            return errors;
    return NULL;
}

/* Check joint errors, which may be NULL, and replace them with NULL if all are 0. */
loewner_status take_errors(const loewner_checker *checker, const double **joint_error);

/* Limit on the steps of a proof; 0 stands for no limit. */
static inline int64_t steps_of(int64_t steps)
{
    return steps > 0 && steps < CODE_NO_LIMIT ? steps : CODE_NO_LIMIT;
}

/* The functions below take a prepared workspace, whose checker they query. */

/* Decide valid configurations. In the mode HASTY, which allocates nothing, configurations that the fast searches leave
   open stay AMBIGUOUS. */
enum { HASTY = -1 };
loewner_status collide(loewner_workspace *workspace, int mode, const double *configurations, size_t n,
                       int8_t *verdicts);

/* Write the verdict for one valid configuration, and the first pair with this verdict; -1 if all pairs are free. */
loewner_status worst_pair(loewner_workspace *workspace, const double *q, int8_t *verdict, int64_t *pair);

/* Write the courses of the next straight motions, from number `first` of n, to the workspace; return how many were
   written, at most MOTIONS_AT_ONCE. */
size_t write_courses(loewner_workspace *workspace, const double *starts, const double *ends, size_t first, size_t n);

/* Prove the n courses in the workspace. They begin at number `first` of all courses to which the options apply. The
   options are checked and have no defaults. The workspace's `fractions` and `found_pairs` receive results, and row k of
   its `work` receives the placed configurations, searches and steps of course k. */
loewner_status prove(loewner_workspace *workspace, size_t first, size_t n, int32_t degree,
                     const loewner_proof_options *options, int8_t *verdicts);

/* Let the kernel prove courses, and confirm nothing. The rows of the workspace's `off`, with `width` numbers each, are
   errors of the values and then of bodies. COLLIDING counts these errors as margins, unless `as_given` is set. Each
   course may take `steps` steps; results are written as `prove` writes them. */
loewner_status certify(loewner_workspace *workspace, const double *courses, int64_t count, int64_t points,
                       int64_t width, double tolerance, int8_t as_given, int64_t steps, int8_t *verdicts);

/* Write the errors of the values of a course (`joint_error` may be NULL), and the errors of bodies with bounds from t0
   to t1; both times may be off by `late`. The row has dof + 3 growing numbers. */
void write_off(const loewner_checker *checker, const double *course, int64_t points, const double *joint_error,
               double t0, double t1, double late, double *row);

/* Write the configuration at a fraction of a course. */
void evaluate(const File *file, const double *course, int32_t degree, double t, double *q);

#endif
