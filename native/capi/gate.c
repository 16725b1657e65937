/* This file checks chunks of targets in a control loop. It proves one course after another, in the same way as
   `loewner/planners/gates.py`. */

#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The pose and the bounds of a body. If only these change, the scene still counts as the same. */
typedef struct {
    double pose[16];
    loewner_bounds bounds;
} Known;

/* A motion or a brake that could not be proven free: the tick at which it begins (-1 if there is none), the number of
   targets on which it depends, and the pair and the reason of the failure. As long as the world and these targets stay
   the same, the proof is not tried again. */
typedef struct {
    int64_t tick, needed, pair;
    int32_t reason;
} Stop;

static const Stop NONE = {-1, 0, -1, 0};

/* A chunk, and how much of it is proven; see `_Chunk` in gates.py. */
typedef struct {
    double *rows; /* `count` + 1 rows: the start and the targets. The row before the start precedes them in memory. */
    double *rates;
    int64_t *ends; /* For each tick: the number of targets that were known when the brake from this tick was proven. */
    double dt, t0;
    int64_t count, motions, first, braked;
    Stop motion_stop, brake_stop;
} Chunk;

/* State of the proofs in one check: the reason why one failed (0 if none did), the pair at which it failed, the limit
   on the work of all proofs, and their work so far. */
typedef struct {
    int32_t reason;
    int64_t pair, most, work;
    double dt;      /* The time from one target to the next. */
    int is_attempt; /* Whether the proof is only an attempt, whose failure decides nothing. */
} Proof;

struct loewner_gate {
    const loewner_checker *checker;
    loewner_workspace *workspace;
    int64_t dof, most, steps, pieces; /* `pieces`: the largest number of times in a brake. */
    int on_path, has_jerk, has_last, wants_scale;
    double latency, horizon, tolerance, now;
    /* First, vectors of `dof` numbers, and the times of the ticks (`at`); then, the arrays that describe the brake. */
    double *strongest, *jerk, *fastest, *error, *rate_error, *widened, *looser, *resting, *q, *at;
    double *times, *states, *courses, *seconds, *out[3];
    /* Number of times in the brake's arrays, and index of the row by which the brake has ended; index 0 is the row
       before the chunk. */
    int64_t pieces_made, rows_needed;
    Chunk last, made, slower;
    uint64_t structure; /* Serial number that the scene had when the last chunk was accepted. */
    Known *seen, *allowed; /* The bodies as they are now, and as they were when the last chunk was accepted. */
    size_t known, room;
    void *memory;
};

/* -- making -------------------------------------------------------------------------------------------------------- */

/* Check and copy one number for each joint (a limit or an error). If `given` is NULL, use `otherwise` for all. */
static loewner_status take(const char *name, const double *given, int64_t dof, double otherwise, double *out)
{
    int is_error = otherwise == 0;
    for (int64_t c = 0; c < dof; c++) {
        out[c] = given == NULL ? otherwise : given[c];
        REQUIRE(given == NULL || ((out[c] > 0 || (is_error && out[c] == 0)) && out[c] < INFINITY),
                "%s: expected finite numbers %s 0, found %g", name, is_error ? ">=" : ">", out[c]);
    }
    return LOEWNER_OK;
}

static loewner_status take_options(loewner_gate *gate, const loewner_gate_options *options)
{
    int64_t dof = gate->dof;
    const double numbers[] = {options->latency, options->horizon, options->tolerance};
    static const char *const names[] = {"latency", "horizon", "tolerance"};
    for (int k = 0; k < 3; k++)
        REQUIRE(numbers[k] >= 0 && numbers[k] < INFINITY, "%s: expected a number >= 0, found %g", names[k], numbers[k]);
    REQUIRE(options->steps >= 0, "steps: expected a number >= 0, found %lld", (long long)options->steps);
    REQUIRE(options->brake == LOEWNER_BRAKE_JOINTS || options->brake == LOEWNER_BRAKE_PATH,
            "brake: expected LOEWNER_BRAKE_JOINTS or _PATH, found %d", options->brake);
    REQUIRE(options->acceleration != NULL, "acceleration: expected limits, found NULL");
    TRY(take("acceleration", options->acceleration, dof, INFINITY, gate->strongest));
    TRY(take("jerk", options->jerk, dof, INFINITY, gate->jerk));
    TRY(take("velocity", options->velocity, dof, INFINITY, gate->fastest));
    if (options->velocity == NULL)
        memcpy(gate->fastest, gate->checker->file->limits + 4 * dof, sizeof(double) * (size_t)dof);
    TRY(take("joint_error", options->joint_error, dof, 0, gate->error));
    TRY(take("velocity_error", options->velocity_error, dof, 0, gate->rate_error));
    gate->on_path = options->brake == LOEWNER_BRAKE_PATH;
    gate->has_jerk = options->jerk != NULL;
    gate->wants_scale = options->wants_scale;
    gate->latency = options->latency;
    gate->horizon = options->horizon > 0 ? options->horizon : INFINITY;
    gate->tolerance = options->tolerance > 0 ? options->tolerance : TOLERANCE;
    gate->steps = steps_of(options->steps);
    return LOEWNER_OK;
}

/* Allocate one block of memory, and divide it among the arrays. */
static loewner_status make_room(loewner_gate *gate)
{
    size_t vector = sizeof(double) * (size_t)gate->dof, ticks = (size_t)gate->most + 2, pieces = (size_t)gate->pieces;
#define VECTOR(field) {(void **)&gate->field, vector}
#define PIECES(field, size) {(void **)&gate->field, (size) * pieces}
#define TICKS(field, size) {(void **)&gate->field, (size) * ticks}
#define CHUNK_PARTS(chunk) TICKS(chunk.rows, vector), TICKS(chunk.rates, vector), TICKS(chunk.ends, sizeof(int64_t))
    const Part parts[] = {
        VECTOR(strongest), VECTOR(jerk), VECTOR(fastest), VECTOR(error), VECTOR(rate_error), VECTOR(widened),
        VECTOR(looser), VECTOR(resting), VECTOR(q),
        CHUNK_PARTS(last), CHUNK_PARTS(made), CHUNK_PARTS(slower), TICKS(at, sizeof(double)),
        PIECES(times, sizeof(double)), PIECES(seconds, sizeof(double)), PIECES(states, 3 * vector),
        PIECES(courses, 4 * vector), PIECES(out[0], vector), PIECES(out[1], vector), PIECES(out[2], vector),
    };
    size_t count = sizeof parts / sizeof *parts;
    TRY(allocate(&gate->memory, divide(NULL, parts, count)));
    divide(gate->memory, parts, count);
    gate->last.rows += gate->dof;
    gate->made.rows += gate->dof;
    gate->slower.rows += gate->dof;
    return LOEWNER_OK;
}

/* Record the poses and bounds of the scene's bodies; memory is allocated only if there are more bodies than before. */
static loewner_status look(loewner_gate *gate)
{
    const loewner_checker *checker = gate->checker;
    const State *state = &checker->state;
    gate->known = (size_t)state->standing;
    if (gate->room < gate->known) {
        TRY(enlarge(&gate->seen, gate->known * sizeof(Known)));
        TRY(enlarge(&gate->allowed, gate->known * sizeof(Known)));
        gate->room = gate->known;
    }
    for (size_t k = 0; k < gate->known; k++) {
        const Body *body = checker->bodies + state->body[(size_t)state->moving + k];
        Known *its = gate->seen + k;
        memcpy(its->pose, body->pose, sizeof its->pose);
        its->bounds = body->has_bounds ? body->bounds : (loewner_bounds){0, 0, 0, 0, 0};
    }
    return LOEWNER_OK;
}

/* Set up a gate for which only the structure itself has been allocated so far. */
static loewner_status set_up(loewner_gate *gate, const loewner_gate_options *options)
{
    TRY(make_room(gate));
    TRY(take_options(gate, options));
    TRY(loewner_workspace_new(&gate->workspace));
    TRY(prepare(gate->checker, gate->workspace));
    return look(gate);
}

loewner_status loewner_gate_new(const loewner_checker *checker, const loewner_gate_options *options,
                                size_t most_targets, loewner_gate **gate)
{
    REQUIRE(checker != NULL && options != NULL && gate != NULL,
            "checker, options, gate: expected pointers, found NULL");
    *gate = NULL;
    REQUIRE(most_targets >= 1 && most_targets <= 1000000, "most_targets: expected 1 to 1000000, found %zu",
            most_targets);
    REQUIRE(checker->file->quaternion_count == 0,
            "checker: expected a robot without floating and ball joints, found one");
    loewner_gate *made;
    TRY(allocate(&made, sizeof *made));
    int64_t dof = checker->file->dof, most = (int64_t)most_targets, pieces = 3 * dof + 1;
    pieces = pieces > most + 6 ? pieces : most + 6;
    *made = (loewner_gate){.checker = checker, .dof = dof, .most = most, .pieces = pieces, .now = -INFINITY};
    loewner_status outcome = set_up(made, options);
    if (outcome == LOEWNER_OK)
        *gate = made;
    else
        loewner_gate_free(made);
    return outcome;
}

void loewner_gate_free(loewner_gate *gate)
{
    if (gate == NULL)
        return;
    loewner_workspace_free(gate->workspace);
    free(gate->seen);
    free(gate->allowed);
    free(gate->memory);
    free(gate);
}

/* -- older proofs -------------------------------------------------------------------------------------------------- */

/* Return whether all poses that a body may have from now on were allowed before, as `_path_is_within` in gates.py does.
   A point at a distance r from the body's origin moves by at most r times the norm of the difference between the two
   rotations. */
static int is_within(const Known *seen, const Known *allowed, double now)
{
    const loewner_bounds *its = &seen->bounds, *old = &allowed->bounds;
    double away = 0, turned = 0, far = 0;
    if (memcmp(seen, allowed, sizeof *seen) == 0)
        return 1;
    if (fmax(its->since, old->since) > now || its->speed > old->speed || its->turn > old->turn)
        return 0;
    for (int k = 0; k < 12; k++) {
        double step = seen->pose[k] - allowed->pose[k];
        *(k % 4 == 3 ? &away : &turned) += step * step;
        far = k % 4 == 3 ? fmax(far, fabs(seen->pose[k])) : far;
    }
    away = sqrt(away) + its->metres + its->speed * (now - its->since);
    away += away > 0 ? WITHIN * (1 + fabs(now) + far) : 0;
    /* Rotation matrices are orthonormal only up to a tolerance. */
    turned = sqrt(turned / 2) + (turned > 0 ? 16 * ROTATION_TOLERANCE : 0);
    turned += its->radians + its->turn * (now - its->since) + (turned > 0 ? WITHIN * (1 + fabs(now)) : 0);
    return away <= old->metres + old->speed * (now - old->since) &&
           turned <= old->radians + old->turn * (now - old->since);
}

/* Return whether all bodies have the same poses and bounds as when the last chunk was accepted. */
static int is_same_world(const loewner_gate *gate)
{
    return gate->known == 0 || memcmp(gate->seen, gate->allowed, gate->known * sizeof *gate->seen) == 0;
}

static Stop later(Stop stop, int64_t tick)
{
    stop.needed -= tick;
    stop.tick = stop.tick >= tick ? stop.tick - tick : -1;
    return stop;
}

/* Return where a proof failed. The tick is -1 if the proof did not fail, or failed only because it reached its limit on
   work. */
static Stop stop_at(int64_t tick, int64_t needed, const Proof *proof)
{
    int is_known = proof->reason && proof->reason != LOEWNER_REASON_BUDGET;
    return (Stop){is_known ? tick : -1, needed, proof->pair, proof->reason};
}

/* Write the range of ticks of the last chunk at which the robot may be, and return whether the chunk's proofs still
   hold. A robot that executes the answers is never beyond the proven motions. */
static int find_ticks(const loewner_gate *gate, int64_t *from, int64_t *to)
{
    const Chunk *last = &gate->last;
    double now = gate->now;
    *from = *to = 0;
    if (!gate->has_last)
        return 0;
    double tick = rint((now - last->t0) / last->dt);
    if (gate->checker->state.growing == 0) {
        *to = last->motions + 1;
    } else if (tick >= 0 && tick <= (double)last->motions &&
               fabs(last->t0 + tick * last->dt - now) <= SAME_TICK * last->dt) {
        *from = (int64_t)tick;
        *to = *from + 1;
    }
    int holds = gate->structure == gate->checker->serial;
    for (size_t k = 0; k < gate->known && holds; k++)
        holds = is_within(gate->seen + k, gate->allowed + k, now);
    return holds;
}

/* Return a tick of the last chunk, in the range from..to, that agrees with a measured state; -1 if no such tick is
   left. If the robot is slow, several ticks may agree, and each call returns the next one of them. The tick of the
   present time comes first unless it is 0, even if no body moves; the other ticks follow in order of their distance
   from the measured configuration. At the first call, `*off` and `tick` are -1; at every later call, they are the
   distance and the tick from the previous call. */
static int64_t next_tick(const loewner_gate *gate, const double *q, const double *dq, int64_t from, int64_t to,
                         double *off, int64_t tick)
{
    double nearest = INFINITY, now = rint((gate->now - gate->last.t0) / gate->last.dt);
    int64_t found = -1;
    for (int64_t k = from; k < to; k++) {
        const double *row = gate->last.rows + k * gate->dof, *rate = gate->last.rates + k * gate->dof;
        double away = 0;
        int is_in_tube = 1;
        for (int64_t c = 0; c < gate->dof && is_in_tube; c++) {
            away = fmax(away, fabs(q[c] - row[c]));
            is_in_tube = fabs(q[c] - row[c]) <= gate->error[c] && fabs(dq[c] - rate[c]) <= gate->rate_error[c];
        }
        away = k > 0 && (double)k == now ? -1 : away;
        if (is_in_tube && (away > *off || (away == *off && k > tick)) && away < nearest) {
            nearest = away;
            found = k;
        }
    }
    *off = nearest;
    return found;
}

static int64_t periods(const loewner_gate *gate, double dt)
{
    double count = ceil(gate->latency / dt * (1 - SAME_TICK));
    return count > (double)gate->most ? gate->most + 1 : (int64_t)count;
}

static void write_rates(const loewner_gate *gate, Chunk *chunk)
{
    for (int64_t k = gate->dof; k < (chunk->count + 1) * gate->dof; k++)
        chunk->rates[k] = (chunk->rows[k] - chunk->rows[k - gate->dof]) / chunk->dt;
}

/* Return whether the targets continue the last chunk, unchanged, from the tick `tick` on. If they do, make a chunk that
   keeps the proofs from this tick on and has the new targets at its end. */
static int goes_on(loewner_gate *gate, int64_t tick, const double *targets, int64_t count, double dt)
{
    const Chunk *last = &gate->last;
    Chunk *made = &gate->made;
    int64_t dof = gate->dof, known = last->count - tick, common = known < count ? known : count;
    const double *here = last->rows + tick * dof;
    if (common == 0 || dt != last->dt || memcmp(here + dof, targets, (size_t)(common * dof) * sizeof *targets) != 0)
        return 0;
    memcpy(made->rows - dof, here - dof, 2 * (size_t)dof * sizeof *here);
    memcpy(made->rows + dof, targets, (size_t)(count * dof) * sizeof *targets);
    memcpy(made->rates, last->rates + tick * dof, (size_t)dof * sizeof *here);
    made->dt = dt;
    made->t0 = gate->checker->state.growing > 0 ? last->t0 + (double)tick * dt : gate->now;
    made->count = count;
    write_rates(gate, made);
    made->motions = last->motions - tick < 0 ? 0 : last->motions - tick < count ? last->motions - tick : count;
    made->first = last->first - tick;
    made->braked = last->braked - tick < count ? last->braked - tick : count;
    for (int64_t k = 0; k <= made->braked; k++)
        made->ends[k] = last->ends[tick + k] - tick;
    int64_t first = made->first > 0 ? made->first : 0;
    /* A brake that was proven on a path with more targets does not count for this chunk. */
    while (gate->on_path && made->braked >= first && made->ends[made->braked] > count)
        made->braked--;
    const Stop stops[] = {later(last->motion_stop, tick), later(last->brake_stop, tick)};
    /* A failed proof is not tried again if the world is the same and the chunk contains all targets on which the
       failure depends. */
    int is_same = is_same_world(gate);
    made->motion_stop = is_same && stops[0].needed <= count ? stops[0] : NONE;
    made->brake_stop = is_same && stops[1].needed <= count ? stops[1] : NONE;
    return 1;
}

/* -- proofs -------------------------------------------------------------------------------------------------------- */

static loewner_status prove_course(loewner_gate *gate, const double *course, int64_t points, const double *error,
                                   double t0, double t1, Proof *proof)
{
    loewner_workspace *its = gate->workspace;
    const loewner_checker *checker = gate->checker;
    double late = SAME_TICK * proof->dt + 0x1p-49 * fmax(fabs(t0), fabs(t1));
    int64_t growing = 3 * checker->state.growing;
    int8_t verdict;
    if (proof->work >= proof->most) {
        proof->reason = LOEWNER_REASON_BUDGET;
        return LOEWNER_OK;
    }
    error = if_any(error, gate->dof);
    write_off(checker, course, points, error, t0, t1, late, its->off);
    TRY(certify(its, course, 1, points, error != NULL || growing > 0 ? gate->dof + growing : 0, gate->tolerance, 0,
                proof->most - proof->work, &verdict));
    proof->work += its->work[WORK - 1];
    proof->pair = *its->found_pairs;
    if (verdict == LOEWNER_FREE)
        return LOEWNER_OK;
    proof->reason = LOEWNER_REASON_BUDGET;
    if (proof->is_attempt)
        return LOEWNER_OK;
    evaluate(checker->file, course, (int32_t)points - 1, isnan(*its->fractions) ? 0 : *its->fractions, gate->q);
    TRY(collide(its, HASTY, gate->q, 1, &verdict));
    proof->reason = verdict == LOEWNER_COLLIDING        ? LOEWNER_REASON_CONTACT
                    : proof->work >= proof->most ? LOEWNER_REASON_BUDGET
                                                 : LOEWNER_REASON_MAY_BE_HIT;
    return LOEWNER_OK;
}

/* Arguments that pass the arrays of a gate's brake to a kernel. */
#define BRAKE(gate)                                                                                                    \
    .times = {gate->times, 1, gate->pieces}, .states = {gate->states, 1, gate->pieces, 3, gate->dof},                  \
    .counts = {&gate->pieces_made, 1}

/* Compute the brake that stops each joint separately, from the state `q`, `dq`. */
static loewner_status stop(loewner_gate *gate, const double *q, const double *dq)
{
    int64_t dof = gate->dof;
    return CALL(brakes_by_joint, NULL, .Q = {q, 1, dof}, .V = {dq, 1, dof}, .A = {gate->resting, 1, dof},
                .strongest = {gate->strongest, dof}, .jerk = {gate->jerk, dof}, BRAKE(gate));
}

/* Compute the brake that begins at a tick of a chunk. If the robot brakes on the path, the brake follows the part of
   the path that was known when this brake was proven. */
static loewner_status brake_from(loewner_gate *gate, const Chunk *chunk, int64_t tick)
{
    int64_t dof = gate->dof, rows = chunk->ends[tick] + 2;
    if (!gate->on_path)
        return stop(gate, chunk->rows + tick * dof, chunk->rates + tick * dof);
    for (int64_t k = 0; k < rows; k++)
        gate->at[k] = chunk->dt * (double)k;
    return CALL(brakes_on_path, NULL, .rows = {chunk->rows - dof, rows, dof}, .at = {gate->at, rows},
                .begins = {gate->at + tick + 1, 1}, .strongest = {gate->strongest, dof}, .jerk = {gate->jerk, dof},
                .beyond = 1, .needed = {&gate->rows_needed, 1}, BRAKE(gate));
}

static double stopping_time(const loewner_gate *gate, int64_t c, double v)
{
    double strongest = gate->strongest[c], jerk = gate->jerk[c];
    if (!gate->has_jerk)
        return v / strongest;
    return v <= strongest * strongest / jerk ? 2 * sqrt(v / jerk) : v / strongest + strongest / jerk;
}

/* Try to prove that a whole brake, taken as one course, is free, in at most `steps` steps. If no body is near, one
   interval is enough. The robot may come to rest as late as `until` seconds after the brake began. */
static loewner_status prove_whole(loewner_gate *gate, double begin, int64_t points, double until, int64_t steps,
                                  Proof *proof, int *is_free)
{
    int64_t dof = gate->dof;
    Proof attempt = {0, -1, proof->work + steps, proof->work, proof->dt, 1};
    TRY(CALL(whole_brakes, NULL, .until = {&until, 1}, .courses = {gate->courses, 1, points, dof},
             .off = {gate->looser, 1, dof}, BRAKE(gate)));
    for (int64_t c = 0; c < dof; c++)
        gate->looser[c] += gate->widened[c];
    until = fmax(until, gate->times[gate->pieces_made - 1]);
    TRY(prove_course(gate, gate->courses, points, gate->looser, begin, begin + until, &attempt));
    proof->work = attempt.work;
    *is_free = !attempt.reason;
    return LOEWNER_OK;
}

/* Prove that the most recent brake is free. The brake begins at the time `begin` with the velocity `rate`; if the robot
   brakes on the path, `rate` is NULL. A robot that is faster than `rate` by the velocity error travels farther and
   comes to rest later. For a joint-by-joint brake, first try to prove the whole brake as one course, in at most `steps`
   steps. */
static loewner_status prove_brake(loewner_gate *gate, double begin, const double *rate, int64_t steps, Proof *proof)
{
    int64_t dof = gate->dof, points = gate->has_jerk || rate == NULL ? 4 : 3, pieces = gate->pieces_made - 1, made;
    double stands = 0, end = begin + gate->times[pieces];
    int is_off = 0, is_free = 0;
    for (int64_t c = 0; c < dof; c++) {
        double v = rate == NULL ? 0 : fabs(rate[c]), fast = v + gate->rate_error[c];
        gate->widened[c] = gate->error[c];
        if (rate != NULL)
            gate->widened[c] += (fast * stopping_time(gate, c, fast) - v * stopping_time(gate, c, v)) / 2;
        stands = fmax(stands, rate != NULL ? stopping_time(gate, c, fast) : 0);
        is_off |= rate != NULL && gate->rate_error[c] > 0;
    }
    int rests = is_off && stands > gate->times[pieces] && (gate->checker->state.growing > 0 || pieces == 0);
    if (rate != NULL && pieces > 1 && steps > 0)
        TRY(prove_whole(gate, begin, points, rests ? stands : 0, steps, proof, &is_free));
    if (is_free)
        return LOEWNER_OK;
    TRY(CALL(courses_of_brakes, &made, .courses = {gate->courses, pieces, points, dof},
             .seconds = {gate->seconds, pieces}, BRAKE(gate)));
    if (rate == NULL || pieces > 1) {
        /* Check the end of the brake first, because long brakes fail there most often, and because this check halves no
           interval. */
        double *still = gate->courses + pieces * points * dof;
        for (int k = 0; k < 2; k++)
            memcpy(still + k * dof, gate->states + 3 * pieces * dof, (size_t)dof * sizeof *still);
        TRY(prove_course(gate, still, 2, gate->widened, end, end, proof));
    }
    for (int64_t k = 0; k < pieces && !proof->reason; k++)
        TRY(prove_course(gate, gate->courses + k * points * dof, points, gate->widened, begin + gate->times[k],
                         begin + gate->times[k + 1], proof));
    if (!rests || proof->reason)
        return LOEWNER_OK;
    for (int64_t k = 0; k < points; k++)
        memcpy(gate->courses + k * dof, gate->states + 3 * pieces * dof, (size_t)dof * sizeof *gate->courses);
    return prove_course(gate, gate->courses, points, gate->widened, end, begin + stands, proof);
}

/* Prove that the motions are free, and then that the brakes from the ends of the proven motions are free. Both loops
   stop at the first motion or brake that is not proven free. */
static loewner_status prove_chunk(loewner_gate *gate, Chunk *chunk, Proof *proof)
{
    int64_t dof = gate->dof, growing = gate->checker->state.growing;
    double most = 0;
    for (int64_t k = 0; gate->on_path && k < (chunk->count + 1) * dof; k++)
        most = fmax(most, fabs(chunk->rows[k]));
    for (int64_t c = 0; c < dof; c++)
        gate->widened[c] = gate->error[c] + ROUNDED * most;
    for (const Stop *stop = &chunk->motion_stop; chunk->motions < chunk->count; chunk->motions++) {
        double begin = chunk->t0 + chunk->dt * (double)chunk->motions;
        if (stop->tick == chunk->motions) {
            proof->reason = stop->reason;
            proof->pair = stop->pair;
            break;
        }
        TRY(prove_course(gate, chunk->rows + chunk->motions * dof, 2, gate->widened, begin, begin + chunk->dt, proof));
        chunk->motion_stop = stop_at(chunk->motions, chunk->motions + 1, proof);
        if (proof->reason)
            break;
    }
    const Proof motions = *proof;
    const Stop *stop = &chunk->brake_stop;
    int64_t tick = chunk->braked + 1 > chunk->first ? chunk->braked + 1 : chunk->first;
    proof->reason = 0;
    proof->pair = -1;
    tick = tick > 0 ? tick : 0;
    /* The proof of a whole brake may take about as many steps as a proof needs for one interval. If too few steps are
       left for all brakes, no brake is tried as a whole. */
    int64_t pairs = gate->checker->state.pairs, steps = pairs > LEAST_STEPS ? pairs : LEAST_STEPS;
    if (proof->most - proof->work < steps * (chunk->motions - tick + 1))
        steps = 0;
    for (; tick <= chunk->motions; tick++) {
        if (stop->tick == tick && stop->needed <= chunk->count) {
            proof->reason = stop->reason;
            proof->pair = stop->pair;
            break;
        }
        chunk->ends[tick] = chunk->count;
        TRY(brake_from(gate, chunk, tick));
        int64_t end = gate->on_path ? gate->rows_needed - 1 : tick;
        /* If no body has bounds, proven motions are free at all times, and so are brakes on these motions. */
        int is_covered = gate->on_path && growing == 0 && end <= chunk->motions;
        if (!is_covered)
            TRY(prove_brake(gate, chunk->t0 + chunk->dt * (double)tick,
                            gate->on_path ? NULL : chunk->rates + tick * dof, steps, proof));
        if (proof->reason) {
            if (proof->reason == LOEWNER_REASON_CONTACT)
                proof->reason = LOEWNER_REASON_BRAKE;
            /* If there were more targets, a brake that goes beyond the last target would take another path. */
            chunk->brake_stop.tick = -1;
            if (end <= chunk->count)
                chunk->brake_stop = stop_at(tick, end, proof);
            break;
        }
        chunk->braked = tick;
    }
    if (!proof->reason) {
        proof->reason = motions.reason;
        proof->pair = motions.pair;
    }
    return LOEWNER_OK;
}

/* Find the largest time scale (a half, a quarter or an eighth) at which the whole chunk is proven free; 0 if there is
   none. */
static loewner_status find_scale(loewner_gate *gate, Proof *proof, double *scale)
{
    const Chunk *chunk = &gate->made;
    Chunk *slower = &gate->slower;
    Proof attempt = *proof;
    for (*scale = 0.5; *scale > 0.1; *scale /= 2) {
        double dt = chunk->dt / *scale;
        int64_t late = periods(gate, dt);
        *slower = (Chunk){chunk->rows, slower->rates, slower->ends, dt, chunk->t0, chunk->count,
                          0, late + 1, late, NONE, NONE};
        for (int64_t c = 0; c < gate->dof; c++)
            slower->rates[c] = *scale * chunk->rates[c];
        write_rates(gate, slower);
        attempt.reason = 0;
        attempt.dt = dt;
        TRY(prove_chunk(gate, slower, &attempt));
        if (!attempt.reason)
            break;
    }
    *scale = attempt.reason ? 0 : *scale;
    proof->work = attempt.work;
    return LOEWNER_OK;
}

/* -- checks -------------------------------------------------------------------------------------------------------- */

/* Return the number of targets before the first one that violates the limits. Write the joint at which this target
   violates them, or -1 if no target does. */
static int64_t within_limits(const loewner_gate *gate, const double *q, const double *targets, int64_t count, double dt,
                             int32_t *joint)
{
    const double *lower = gate->checker->file->limits + 2 * gate->dof, *upper = lower + gate->dof;
    for (int64_t k = 0; k < count; k++)
        for (int64_t c = 0; c < gate->dof; c++) {
            double to = targets[k * gate->dof + c], from = k == 0 ? q[c] : targets[(k - 1) * gate->dof + c];
            /* The speed to the first target is computed from the measured `q`, from which the last command may differ
               by the joint error. */
            double speed = fabs(to - from) / dt - (k == 0 ? gate->error[c] / dt : 0);
            if (to < lower[c] || to > upper[c] || speed > gate->fastest[c] * (1 + SAME_TICK)) {
                *joint = (int32_t)c;
                return k;
            }
        }
    *joint = -1;
    return count;
}

/* Write an answer that contains the most recent brake. */
static loewner_status answer_with(loewner_gate *gate, int32_t state, int64_t steps, int is_proven, double begins,
                                  const Proof *proof, loewner_gate_answer *answer)
{
    size_t size = (size_t)gate->dof * sizeof(double);
    int is_finite = 1;
    for (int64_t k = 0; k < gate->pieces_made; k++) {
        is_finite &= isfinite(gate->times[k]) != 0;
        for (int m = 0; m < 3; m++)
            memcpy(gate->out[m] + k * gate->dof, gate->states + (3 * k + m) * gate->dof, size);
        for (int64_t c = 0; c < 3 * gate->dof; c++)
            is_finite &= isfinite(gate->states[3 * k * gate->dof + c]) != 0;
    }
    if (!is_finite)
        return fail(LOEWNER_OVERFLOW, "expected a brake of finite length and time, found an overflow");
    *answer = (loewner_gate_answer){
        .state = state, .reason = proof->reason, .steps = steps > 0 ? (size_t)steps : 0, .scale = answer->scale,
        .joint = proof->reason == LOEWNER_REASON_LIMITS ? answer->joint : -1, .is_proven = is_proven,
        .work = proof->work, .begins = begins, .brake_count = (size_t)gate->pieces_made, .times = gate->times,
        .positions = gate->out[0], .velocities = gate->out[1], .accelerations = gate->out[2],
    };
    write_bodies(&gate->checker->state, proof->reason ? proof->pair : -1, answer->bodies);
    return LOEWNER_OK;
}

/* Begin a new chunk at `q`; or, if `goes_on`, drop the proofs of the chunk in `made`, which begins at a command of the
   last chunk. If a pair is not free at the robot's position, write this pair to `proof`. */
static loewner_status begin_chunk(loewner_gate *gate, int goes_on, const double *q, const double *dq,
                                  const double *targets, int64_t count, int64_t late, Proof *proof)
{
    Chunk *made = &gate->made;
    size_t size = (size_t)gate->dof * sizeof *q;
    if (!goes_on) {
        memcpy(made->rows - gate->dof, q, size);
        memcpy(made->rows, q, size);
        memcpy(made->rows + gate->dof, targets, (size_t)count * size);
        memcpy(made->rates, dq, size);
    }
    *made = (Chunk){made->rows, made->rates, made->ends, proof->dt, gate->now, count, 0, late + 1, late, NONE, NONE};
    write_rates(gate, made);
    loewner_workspace *its = gate->workspace;
    double *still = gate->courses;
    int8_t verdict;
    memcpy(still, q, size);
    memcpy(still + gate->dof, q, size);
    TRY(collide(its, HASTY, still, 1, &verdict));
    if (verdict == LOEWNER_AMBIGUOUS)
        TRY(collide(its, CODE_EXACT, still, 1, &verdict));
    if (verdict == LOEWNER_FREE)
        return LOEWNER_OK;
    /* In this motion, the robot stays at `q`; the attempt to prove the motion free shows which pair is not free. */
    TRY(certify(its, still, 1, 2, 0, gate->tolerance, 0, gate->steps, &verdict));
    proof->pair = *its->found_pairs;
    proof->reason = LOEWNER_REASON_CONTACT;
    return LOEWNER_OK;
}

/* Accept the chunk in `made`, which becomes the last chunk. From now on, the bodies may only have the poses that their
   present poses and bounds allow. If the chunk keeps proofs of the previous one, the earlier bounds allow all these
   poses, so the old proofs still hold. */
static void adopt(loewner_gate *gate)
{
    const Chunk made = gate->made;
    gate->made = gate->last;
    gate->last = made;
    gate->has_last = 1;
    Known *seen = gate->seen;
    gate->seen = gate->allowed;
    gate->allowed = seen;
    gate->structure = gate->checker->serial;
}

static loewner_status judge(loewner_gate *gate, const double *q, const double *dq, const double *targets,
                            int64_t wanted, double dt, loewner_gate_answer *answer)
{
    double now = gate->now;
    int64_t late = periods(gate, dt), from, to, tick;
    int64_t count = within_limits(gate, q, targets, wanted, dt, &answer->joint);
    Proof proof = {0, -1, gate->steps, 0, dt, 0};
    TRY(look(gate));
    int holds = find_ticks(gate, &from, &to);
    double off = -1;
    for (tick = -1; (tick = next_tick(gate, q, dq, from, to, &off, tick)) >= 0;)
        if (goes_on(gate, tick, targets, count, dt))
            break;
    if (tick < 0 || !holds) {
        TRY(begin_chunk(gate, tick >= 0, q, dq, targets, count, late, &proof));
        if (proof.reason) {
            gate->has_last = 0;
            answer->scale = 0;
            TRY(stop(gate, q, dq));
            return answer_with(gate, LOEWNER_GATE_INSIDE, 0, 0, 0, &proof, answer);
        }
    }
    Chunk *made = &gate->made;
    TRY(prove_chunk(gate, made, &proof));
    if (!proof.reason && count < wanted)
        proof.reason = LOEWNER_REASON_LIMITS;
    /* If the robot were ordered to brake now, it would only begin to do so at the last target or later. */
    if (!proof.reason && count <= late)
        proof.reason = LOEWNER_REASON_BRAKE;
    int64_t steps = made->braked - late;
    answer->scale = proof.reason ? 0 : 1;
    int may_scale = proof.reason == LOEWNER_REASON_BRAKE ||
                    (proof.reason && proof.reason != LOEWNER_REASON_LIMITS && gate->checker->state.growing > 0);
    /* If a proof failed and `may_scale` is false, slower motions would meet the same obstacle. */
    if (gate->wants_scale && may_scale && count > late)
        TRY(find_scale(gate, &proof, &answer->scale));
    if (!proof.reason || steps > 0) {
        adopt(gate);
        TRY(brake_from(gate, &gate->last, gate->last.braked));
        return answer_with(gate, proof.reason ? LOEWNER_GATE_PREFIX : LOEWNER_GATE_GO, steps, 1,
                           dt * (double)gate->last.braked, &proof, answer);
    }
    /* This chunk may not run, so the robot continues along the last accepted chunk until it brakes. With a latency, the
       place at which it brakes depends on its present tick. */
    off = -1;
    int64_t here = next_tick(gate, q, dq, from, to, &off, -1), other = next_tick(gate, q, dq, from, to, &off, here);
    int is_sure = other < 0 || (here > 0 && (double)here == rint((now - gate->last.t0) / gate->last.dt));
    off = -1;
    for (tick = -1; holds && (tick = next_tick(gate, q, dq, from, to, &off, tick)) >= 0;)
        if ((late == 0 || (is_sure && tick == here)) && gate->last.first <= late + tick &&
            late + tick <= gate->last.braked) {
            TRY(brake_from(gate, &gate->last, late + tick));
            return answer_with(gate, LOEWNER_GATE_BRAKE, 0, 1, dt * (double)late, &proof, answer);
        }
    Proof stopping = {0, -1, proof.most, proof.work, dt, 0};
    TRY(stop(gate, q, dq));
    if (late == 0)
        TRY(prove_brake(gate, now, dq, 0, &stopping));
    proof.work = stopping.work;
    return answer_with(gate, LOEWNER_GATE_BRAKE, 0, late == 0 && !stopping.reason, 0, &proof, answer);
}

loewner_status loewner_gate_check(loewner_gate *gate, const double *q, const double *dq, const double *targets,
                                  size_t n, double dt, double time, loewner_gate_answer *answer)
{
    REQUIRE(gate != NULL && answer != NULL, "gate, answer: expected pointers, found NULL");
    HOLD(gate->workspace);
    REQUIRE(n >= 1 && n <= (size_t)gate->most, "targets: expected 1 to %lld, found %zu", (long long)gate->most, n);
    REQUIRE(dt > 0 && dt < INFINITY, "dt: expected a number > 0, found %g", dt);
    REQUIRE(time >= gate->now && fabs(time) < INFINITY,
            "time: expected one that is no earlier than the last one, %.9g, found %.9g", gate->now, time);
    TRY(prepare(gate->checker, gate->workspace));
    TRY(check_configurations(gate->checker, q, 1, "q"));
    TRY(check_configurations(gate->checker, dq, 1, "dq"));
    TRY(check_configurations(gate->checker, targets, n, "targets"));
    gate->now = time;
    double within = ceil(fmin(gate->horizon / dt, (double)n) * (1 - SAME_TICK));
    return judge(gate, q, dq, targets, within < 1 ? 1 : (int64_t)within, dt, answer);
}
