/* loewner.h: certified collision detection from C, without Python in the process.

   Python prepares a file, and C queries it: `CollisionChecker.save("cell.lwn")` writes a robot and its scene to the
   file, and `loewner_checker_open` maps the file. C and Python give the same answers, from the same machine code.

   VERDICTS. FREE and COLLIDING are proven, including all rounding. AMBIGUOUS means that nothing is proven; treat it as
   not free. `loewner_checker_classify` uses only ellipsoids, and often returns AMBIGUOUS. `..._collide` is exact, and
   returns AMBIGUOUS only if arithmetic could not settle a configuration.

   UNITS are metres and radians. ARRAYS are in C order. A pose is 16 doubles: a 4x4 matrix in row order, which maps
   points of a body to the world, with an orthonormal rotation and the last row 0 0 0 1. A configuration has `dof`
   doubles, in the order of `Robot.configuration_names`; orientations are quaternions wxyz of norm 1.

   OWNERSHIP. An object that a function makes belongs to the caller, who must pass it to `..._close` or `..._free` once;
   both accept NULL. No function keeps a pointer to an argument. Texts that functions return belong to the library.

   LIMITS of joints are ignored, except by `loewner_checker_plan` and gates.

   THREADS. Any number of threads may query a checker or bodies at the same time, each with its own workspace. A call
   that gets a workspace in use by another thread fails. A function that takes a `loewner_checker *` that is not const
   changes the checker, and no other thread may use this checker during the call.

   ERRORS. Functions return LOEWNER_OK or the kind of the error, and `loewner_error_text` describes this thread's last
   error. After an error, outputs have no meaning. Queries check the sizes in their arguments, and check that numbers
   are finite and poses rigid.

   MEMORY. A workspace grows when it is first used with a state of a checker. Later calls of classify, collide,
   clearance and proofs of motions allocate no memory, unless bodies are surfaces or have many pieces. Other queries may
   allocate memory. */

#ifndef LOEWNER_H
#define LOEWNER_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(_WIN32)
#define LOEWNER_API
#else
#define LOEWNER_API __attribute__((visibility("default")))
#endif

#define LOEWNER_VERSION "0.1.0"

typedef enum {
    LOEWNER_OK = 0,
    LOEWNER_BAD_ARGUMENT = 1,  /* an invalid size, number, pose or index */
    LOEWNER_BAD_FILE = 2,      /* the file does not exist, was not written by loewner, or is damaged */
    LOEWNER_OTHER_VERSION = 3, /* the file belongs to another version of loewner: save it again */
    LOEWNER_NO_KERNELS = 4,    /* the machine code is missing, or not for this processor */
    LOEWNER_NO_MEMORY = 5,
    LOEWNER_UNKNOWN_NAME = 6, /* only in loewner.hpp: in C, functions that look up a name return -1 */
    LOEWNER_NOT_FREE = 7, /* the start, all goals, or a motion of a path are outside the limits, or not proven free */
    LOEWNER_NO_PATH = 8,  /* no path was found within the limits on iterations and time */
    LOEWNER_OVERFLOW = 9  /* positions overflow at a configuration */
} loewner_status;

enum { LOEWNER_FREE = 0, LOEWNER_COLLIDING = 1, LOEWNER_AMBIGUOUS = 2 };

typedef struct loewner_checker loewner_checker;
typedef struct loewner_bodies loewner_bodies;
typedef struct loewner_workspace loewner_workspace;

/* Version of the library, which should equal the version of this header, LOEWNER_VERSION. */
LOEWNER_API const char *loewner_version(void);

/* Name of a status, such as "bad file". */
LOEWNER_API const char *loewner_status_name(loewner_status status);

/* Text of this thread's last error: what was expected, and what was found. Valid until the thread's next error. */
LOEWNER_API const char *loewner_error_text(void);

/* Level of processors for which the machine code in use was compiled, such as "x86-64-v3". Without machine code, the
   function returns NULL and sets an error text. */
LOEWNER_API const char *loewner_level(void);

/* -- workspaces ---------------------------------------------------------------------------------------------------- */

/* Memory for queries about any checkers and bodies, for one thread at a time. */
LOEWNER_API loewner_status loewner_workspace_new(loewner_workspace **workspace);
LOEWNER_API void loewner_workspace_free(loewner_workspace *workspace);

/* -- checkers: a robot in a scene ---------------------------------------------------------------------------------- */

/* Open a file that `CollisionChecker.save` wrote.

   The file is mapped into memory, and must not change while the checker is open; replacing it with a new file of the
   same name is safe. Sizes, indices and numbers are checked, so that no file can cause accesses outside the file. There
   is no check that the ellipsoids in the file fit its shapes. */
LOEWNER_API loewner_status loewner_checker_open(const char *path, loewner_checker **checker);
LOEWNER_API void loewner_checker_close(loewner_checker *checker);

/* The numbers of values of a configuration, of links, of bodies (the bodies of links come first), and of checked pairs
   of bodies. */
LOEWNER_API int32_t loewner_checker_dof(const loewner_checker *checker);
LOEWNER_API int32_t loewner_checker_link_count(const loewner_checker *checker);
LOEWNER_API int32_t loewner_checker_body_count(const loewner_checker *checker);
LOEWNER_API int64_t loewner_checker_pair_count(const loewner_checker *checker);

/* Names by number, or NULL for a number without a name. A name is valid until the checker is closed. */
LOEWNER_API const char *loewner_checker_value_name(const loewner_checker *checker, int32_t value);
LOEWNER_API const char *loewner_checker_link_name(const loewner_checker *checker, int32_t link);
LOEWNER_API const char *loewner_checker_body_name(const loewner_checker *checker, int32_t body);

/* Numbers by name, or -1 for an unknown name. The body of a link has the link's name. */
LOEWNER_API int32_t loewner_checker_find_link(const loewner_checker *checker, const char *name);
LOEWNER_API int32_t loewner_checker_find_body(const loewner_checker *checker, const char *name);

/* Limits of the values, shape (dof,) each, narrowed by soft limits; infinite for values without limits. */
LOEWNER_API loewner_status loewner_checker_limits(const loewner_checker *checker, double *lower, double *upper);

/* The bodies of the checked pair number `pair`. */
LOEWNER_API loewner_status loewner_checker_pair(const loewner_checker *checker, int64_t pair, int32_t bodies[2]);

/* -- queries of configurations ------------------------------------------------------------------------------------- */

/* Verdicts for n configurations, shape (n, dof): `..._classify` uses only ellipsoids, and `..._collide` is exact.
   `verdicts` has shape (n,). */
LOEWNER_API loewner_status loewner_checker_classify(const loewner_checker *checker, loewner_workspace *workspace,
                                                    const double *configurations, size_t n, int8_t *verdicts);
LOEWNER_API loewner_status loewner_checker_collide(const loewner_checker *checker, loewner_workspace *workspace,
                                                   const double *configurations, size_t n, int8_t *verdicts);

/* Exact verdict for every checked pair at one configuration; `verdicts` has shape (pairs,). */
LOEWNER_API loewner_status loewner_checker_collide_by_pair(const loewner_checker *checker, loewner_workspace *workspace,
                                                           const double *configuration, int8_t *verdicts);

/* Exact verdicts for poses of all links in the world, shape (links, 16), that another program computed. `verdict`
   receives the verdict for all pairs together, and `verdicts`, shape (pairs,), the verdict for each pair; `verdicts`
   may be NULL. */
LOEWNER_API loewner_status loewner_checker_collide_placed(const loewner_checker *checker, loewner_workspace *workspace,
                                                          const double *link_poses, int8_t *verdict, int8_t *verdicts);

/* Poses of all links at n configurations, shape (n, links, 16). */
LOEWNER_API loewner_status loewner_checker_link_poses(const loewner_checker *checker, const double *configurations,
                                                      size_t n, double *poses);

typedef struct {
    double lower, upper; /* certified bounds on the distance */
    double distance;     /* distance of the nearest pair, or minus the depth of the deepest pair; NaN if not settled */
    int32_t bodies[2];
    double witness_a[3], witness_b[3]; /* the nearest points of the two bodies, in the world */
    double normal[3];                  /* of length 1, from the first body to the second one */
} loewner_distance;

/* Signed distance of the nearest checked pair at n configurations; margins are ignored. `gradients`, shape (n, dof),
   receives derivatives of the distance in metres per radian or metre, and may be NULL. If `distance` is NaN, so is the
   gradient, but the bounds hold. At least one pair must be checked. */
LOEWNER_API loewner_status loewner_checker_distance(const loewner_checker *checker, loewner_workspace *workspace,
                                                    const double *configurations, size_t n, loewner_distance *distances,
                                                    double *gradients);

/* A smooth certified lower bound on the distance of the nearest pair at n configurations, shape (n,), and its
   gradients, shape (n, dof), which may be NULL. `softness` is a length in metres, such as 0.005; see
   `CollisionChecker.clearance`. */
LOEWNER_API loewner_status loewner_checker_clearance(const loewner_checker *checker, loewner_workspace *workspace,
                                                     const double *configurations, size_t n, double softness,
                                                     double *clearances, double *gradients);

/* -- motions ------------------------------------------------------------------------------------------------------- */

typedef struct {
    double tolerance;          /* motions that come nearer than this to contact may be AMBIGUOUS [m]; 0: 1e-5 */
    const double *joint_error; /* shape (dof,), or NULL: deviations of the values up to which FREE holds */
    const double *t0, *t1;     /* shape (n,), or NULL: seconds at which the motions begin and end, see loewner_bounds */
    int64_t steps;             /* steps after which the proof of a motion is given up as AMBIGUOUS; 0: no limit */
    int64_t *steps_taken;      /* shape (n,), or NULL: receives the steps that each motion took */
} loewner_proof_options;       /* a field of 0 means the default; future fields will come last */

/* STEPS measure the work of a proof: placing configurations, comparing pairs of bodies and of pieces, searching, and
   opening boxes around parts of surfaces and around groups of pieces. A motion takes at most `steps` plus a number that
   depends only on the scene; docs/certified.md, "Bounded work", gives this number and the time that steps take. Some
   work is not counted. Once for each motion, a check like `..._collide` confirms COLLIDING on a curve, or confirms the
   start of a motion that is free among solid surfaces. */

/* Prove n motions on which all values change linearly from `starts` to `ends`, shape (n, dof) each, and orientations
   turn the shorter way. FREE holds at every real fraction of a motion; COLLIDING holds at the fraction that
   `fractions`, shape (n,), receives (NaN for FREE). `bodies`, shape (n, 2), receives the pair in question. It is -1 for
   FREE, and for motions that are AMBIGUOUS because they are too long to be proven in about 450,000 intervals.
   `fractions`, `bodies` and `options` may be NULL. */
LOEWNER_API loewner_status loewner_checker_certify_edges(const loewner_checker *checker, loewner_workspace *workspace,
                                                         const double *starts, const double *ends, size_t n,
                                                         const loewner_proof_options *options, int8_t *verdicts,
                                                         double *fractions, int32_t (*bodies)[2]);

/* Find whether each of n straight motions is proven free (1) or not (0), for motion validators. The function gives the
   same answers as `..._certify_edges`, but takes less time if many motions collide, since the workspace learns which
   pairs collide. `options` may be NULL. */
LOEWNER_API loewner_status loewner_checker_motions_free(const loewner_checker *checker, loewner_workspace *workspace,
                                                        const double *starts, const double *ends, size_t n,
                                                        const loewner_proof_options *options, int8_t *is_free);

/* Prove n curves as `..._certify_edges` proves motions. The curves are polynomials of a degree from 1 to 7, given by
   their Bezier points, shape (n, degree + 1, dof). The robot must have no quaternions. */
LOEWNER_API loewner_status loewner_checker_certify_curves(const loewner_checker *checker, loewner_workspace *workspace,
                                                          const double *points, size_t n, int32_t degree,
                                                          const loewner_proof_options *options, int8_t *verdicts,
                                                          double *fractions, int32_t (*bodies)[2]);

typedef struct {
    const uint8_t *joints;     /* shape (dof,): 1 for values that may change (joints with one value); NULL: all */
    const double *joint_error; /* shape (dof,), or NULL */
    int64_t max_iterations;    /* random configurations to draw; 0: no limit */
    double timeout;            /* seconds, checked after 64 to 512 iterations; 0: 10 */
    int64_t cuts;              /* attempts to shorten the path; 0: 60; -1: none */
    uint32_t seed;             /* equal seeds give equal paths, the same as in Python */
} loewner_plan_options;

/* Find a path whose motions are all proven free, from `start`, shape (dof,), to one of several goals, shape (goals,
   dof), as `loewner.planners.plan` does. `path` receives `count` configurations, which belong to the workspace and are
   valid until its next use. `options` may be NULL. */
LOEWNER_API loewner_status loewner_checker_plan(const loewner_checker *checker, loewner_workspace *workspace,
                                                const double *start, const double *goals, size_t goal_count,
                                                const loewner_plan_options *options, const double **path,
                                                size_t *count);

/* Shorten a path of `n` configurations whose motions are all free; the other arguments are as for `..._plan`. */
LOEWNER_API loewner_status loewner_checker_shorten(const loewner_checker *checker, loewner_workspace *workspace,
                                                   const double *path, size_t n, const loewner_plan_options *options,
                                                   const double **shorter, size_t *count);

/* -- changes of the scene ------------------------------------------------------------------------------------------ */

/* Move n bodies of the scene, given by their numbers, to `poses`, shape (n, 16). The next query applies the changes,
   which takes a few microseconds for each body that has moved. */
LOEWNER_API loewner_status loewner_checker_move(loewner_checker *checker, const int32_t *bodies, const double *poses,
                                                size_t n);

/* Add one of the bodies of a file, at a pose, under a name that no other body or link has. The new body is checked
   against everything that moves, with the larger of the scene's margin and the other body's own margin. `body` receives
   the new body's number, and may be NULL. `bodies` may be closed afterwards. */
LOEWNER_API loewner_status loewner_checker_add(loewner_checker *checker, const char *name, const loewner_bodies *bodies,
                                               int64_t which, const double *pose, int32_t *body);

/* Exclude a body of the scene or of a link from all checks, or include it again; numbers of bodies do not change. */
LOEWNER_API loewner_status loewner_checker_set_present(loewner_checker *checker, int32_t body, int present);

/* Attach a body of the scene, even if it is attached already, to a link, at a pose in the frame of the link. The body
   is then checked against the scene and the robot, except for the `touch_count` links that it may touch, and links that
   are rigidly joined to its link. Bodies that Python had attached when the file was saved belong to the robot, and
   cannot be attached or detached. */
LOEWNER_API loewner_status loewner_checker_attach(loewner_checker *checker, int32_t body, int32_t link,
                                                  const double *pose_in_link, const int32_t *touch_links,
                                                  size_t touch_count);

/* Detach a body, which is then at rest in the scene, at a pose in the world. */
LOEWNER_API loewner_status loewner_checker_detach(loewner_checker *checker, int32_t body, const double *pose);

/* Allow two bodies to touch, or forbid it again; and set the distance in metres, >= 0, that two bodies have to keep. A
   pair that was not checked when the file was saved cannot be checked. Settings for two bodies of the scene take effect
   when one of the bodies is attached. */
LOEWNER_API loewner_status loewner_checker_allow(loewner_checker *checker, int32_t a, int32_t b, int allowed);
LOEWNER_API loewner_status loewner_checker_set_margin(loewner_checker *checker, int32_t a, int32_t b, double margin);

/* How far a body of the scene may deviate from its pose at a time t: its origin by metres + speed |t - since|, and its
   orientation by radians + turn |t - since|. A point at the distance r from the origin deviates by no more than the
   first bound plus r times the second bound. */
typedef struct {
    double metres, radians; /* >= 0 */
    double speed, turn;     /* >= 0 [m/s, rad/s], such as 1.6 and 0 for a person */
    double since;           /* [s] */
} loewner_bounds;

/* Set the bounds of a body of the scene, or remove them with NULL; attaching the body removes them, too. While a body
   has bounds, only motions and curves can be proven, and other queries are refused. FREE holds for all places of the
   bodies within their bounds at the times in `loewner_proof_options`, which are required if bounds have a speed or a
   turn. COLLIDING refers to the bodies at their poses. Changing the bounds of a body that already has bounds, or moving
   this body, takes no longer if other bodies have many pieces. */
LOEWNER_API loewner_status loewner_checker_set_bounds(loewner_checker *checker, int32_t body,
                                                      const loewner_bounds *bounds);

/* -- chunks of targets in a control loop --------------------------------------------------------------------------- */

typedef struct loewner_gate loewner_gate;

enum { LOEWNER_BRAKE_JOINTS = 0, LOEWNER_BRAKE_PATH = 1 };

/* What may be executed. GO: all targets. PREFIX: the first `steps` targets. BRAKE: no new target, only the brake.
   INSIDE: only a brake that is not proven, since the robot is already in contact, or nearer to something than its
   margin. */
enum { LOEWNER_GATE_GO = 0, LOEWNER_GATE_PREFIX = 1, LOEWNER_GATE_BRAKE = 2, LOEWNER_GATE_INSIDE = 3 };

/* Why not all targets may be executed. CONTACT: the robot collides on the way to a target. BRAKE: the robot collides
   while it brakes, or the targets end before a brake begins. MAY_BE_HIT: the robot collides only with bodies away from
   their poses, or nothing is proven near contact. LIMITS: a target is outside the limits of a joint, or too fast.
   BUDGET: the steps were used up. */
enum {
    LOEWNER_REASON_NONE = 0,
    LOEWNER_REASON_CONTACT = 1,
    LOEWNER_REASON_BRAKE = 2,
    LOEWNER_REASON_MAY_BE_HIT = 3,
    LOEWNER_REASON_LIMITS = 4,
    LOEWNER_REASON_BUDGET = 5
};

typedef struct {
    int32_t brake;                /* JOINTS: each joint as fast as it can, off the path; PATH: on the path */
    const double *acceleration;   /* limits, > 0; all arrays have shape (dof,) */
    const double *jerk;           /* limits, > 0; NULL: accelerations jump */
    const double *velocity;       /* limits, > 0; NULL: the limits of the robot that was saved, if it has any */
    const double *joint_error;    /* how far the robot may deviate from the motions and the brakes, or NULL */
    const double *velocity_error; /* how far its velocity may deviate when it begins to brake, or NULL */
    double latency;               /* seconds between the order and the brake; rounded up to whole periods */
    double horizon;               /* seconds: only targets within this time are examined; 0: all */
    double tolerance;             /* as in loewner_proof_options */
    int64_t steps;                /* steps that the proofs of a check may take; 0: no limit */
    int32_t wants_scale;          /* 1 to look for the scale, which takes up to three times the work of a new chunk */
} loewner_gate_options;

typedef struct {
    int32_t state, reason;
    size_t steps;      /* targets that may be executed: the motions to them, and a brake from each, are proven free */
    double scale;      /* 1 for GO; or the largest of 1/2, 1/4 and 1/8 of the speed at which all are proven; or 0 */
    int32_t bodies[2]; /* the pair in question; -1 for none */
    int32_t joint;     /* the value whose target is outside the limits; -1 for none */
    int32_t is_proven; /* whether the brake is proven */
    int64_t work;      /* steps that the proofs took */
    /* The brake. If no other answer arrives, the brake begins `begins` seconds after the tick of this check: after
       `steps` targets and the latency. If the state is BRAKE, the order to brake is due immediately, and the robot
       continues to targets of the previous answer until the latency is over. The gate owns these numbers until its next
       check. Between two times, positions follow the cubic that has the given positions and velocities at both times;
       accelerations are the values just after each time. */
    double begins;
    size_t brake_count; /* number of times; at most 3 dof + 1 for LOEWNER_BRAKE_JOINTS */
    const double *times;                                  /* seconds since the brake began, shape (brake_count,) */
    const double *positions, *velocities, *accelerations; /* shape (brake_count, dof) */
} loewner_gate_answer;

/* Make a gate for chunks of up to `most_targets` targets: the counterpart of Python's `loewner.planners.Gate`, whose
   page states its claims. A gate is not a safety function in the sense of IEC 61508 or ISO 13849. The robot must have
   no floating and no ball joints, and targets must be within `loewner_checker_limits`. The checker must live longer
   than the gate; its scene may change between checks. A gate has its own memory, for one thread at a time. A check
   allocates no memory, unless changes of the scene go beyond poses and bounds of bodies, or a new chunk begins within
   rounding of contact. A check waits for no other thread, unless both are the first to query a checker whose scene has
   changed. */
LOEWNER_API loewner_status loewner_gate_new(const loewner_checker *checker, const loewner_gate_options *options,
                                            size_t most_targets, loewner_gate **gate);
LOEWNER_API void loewner_gate_free(loewner_gate *gate);

/* Judge a chunk before it is executed, and again at each tick. From the measured state `q`, `dq`, the robot should
   reach the first of n targets, shape (n, dof), after `dt` seconds. A tick later, a chunk that continues this one
   begins with the second of these targets, and only its new part is proven. `time` is the time of the tick on the clock
   of `loewner_bounds`, and must not run backwards. Without bounds, `time` may be constant. With a latency, however, a
   constant time leaves the brake of a slow robot unproven if the robot's state fits several ticks. After an error, the
   brake of the last answer, which the caller should have copied, is the safe motion. */
LOEWNER_API loewner_status loewner_gate_check(loewner_gate *gate, const double *q, const double *dq,
                                              const double *targets, size_t n, double dt, double time,
                                              loewner_gate_answer *answer);

/* -- pairs of bodies ----------------------------------------------------------------------------------------------- */

/* Open a file of bodies that `Body.save` or `Bodies.save` wrote under a name that ends in .lwn. */
LOEWNER_API loewner_status loewner_bodies_open(const char *path, loewner_bodies **bodies);
LOEWNER_API void loewner_bodies_close(loewner_bodies *bodies);
LOEWNER_API int64_t loewner_bodies_count(const loewner_bodies *bodies);

/* One side of a query about n pairs: in pair k, body `body` (or body k, if `body` is -1) at pose k, or at the only
   pose. */
typedef struct {
    const loewner_bodies *bodies;
    int64_t body;
    const double *poses; /* shape (pose_count, 16); NULL for the identity */
    size_t pose_count;   /* n or 1 */
} loewner_side;

/* Verdicts for n pairs, shape (n,). A pair is FREE only if it is more than `margin` metres apart. */
LOEWNER_API loewner_status loewner_classify(loewner_workspace *workspace, const loewner_side *a, const loewner_side *b,
                                            size_t n, double margin, int8_t *verdicts);
LOEWNER_API loewner_status loewner_collide(loewner_workspace *workspace, const loewner_side *a, const loewner_side *b,
                                           size_t n, double margin, int8_t *verdicts);

/* Signed distances of n pairs; in the results, `bodies` are the numbers of the bodies in their files. */
LOEWNER_API loewner_status loewner_measure(loewner_workspace *workspace, const loewner_side *a, const loewner_side *b,
                                           size_t n, loewner_distance *distances);

#ifdef __cplusplus
}
#endif

#endif
