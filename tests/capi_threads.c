/* Eight threads query one checker, each with a workspace and a gate of its own, between changes of its scene; all have to
   agree. Gates outlive the changes.

   For the sanitizers: see native/sanitize.py. */

#include <loewner.h>
#include <pthread.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { THREADS = 8, COUNT = 300, TARGETS = 12, TICKS = 4 };

static loewner_checker *checker;
static double *configurations;
static int dof;
static int8_t first[3][COUNT];
static double lengths[2];
static int has_bounds;       /* then only gates can answer */
static loewner_gate *shared; /* refused while another thread uses it */

static void expect(loewner_status status)
{
    if (status == LOEWNER_OK)
        return;
    fprintf(stderr, "%s: %s\n", loewner_status_name(status), loewner_error_text());
    exit(1);
}

typedef struct {
    int8_t verdicts[3][COUNT];
    double sum, length, brakes;
    int64_t steps[COUNT], work[COUNT];
    loewner_gate *gate;
} Answers;

/* Chunks from each configuration to the next one, which begin anew, and go on. */
static void check_chunks(Answers *answers)
{
    double *rows = malloc(sizeof(double) * (size_t)dof * (TARGETS + 1));
    loewner_gate_answer answer;
    answers->brakes = 0;
    for (int k = 0; k < COUNT - 1; k += 3)
        for (int tick = 0; tick < TICKS; tick++) {
            for (int j = 0; j <= TARGETS; j++)
                for (int c = 0; c < dof; c++) {
                    const double *from = configurations + dof * k + c;
                    rows[dof * j + c] = *from + 0.002 * (tick + j) * (from[dof] - *from);
                }
            expect(loewner_gate_check(answers->gate, rows, rows + dof, rows + dof, TARGETS, 0.02, 0.0, &answer));
            answers->steps[k] = (int64_t)answer.steps + 100 * answer.state;
            answers->work[k] = answer.work;
            answers->brakes += answer.positions[answer.brake_count * (size_t)dof - 1];
            loewner_status outcome = loewner_gate_check(shared, rows, rows, rows, 1, 0.02, 0.0, &answer);
            if (outcome != LOEWNER_OK && outcome != LOEWNER_BAD_ARGUMENT)
                exit(4);
        }
    free(rows);
}

static void *ask(void *given)
{
    Answers *answers = given;
    loewner_workspace *workspace;
    check_chunks(answers);
    if (has_bounds)
        return NULL;
    loewner_distance distances[COUNT];
    double *gradients = malloc(sizeof(double) * COUNT * (size_t)dof),
           *poses = malloc(sizeof(double) * 16 * (size_t)loewner_checker_link_count(checker));
    expect(loewner_workspace_new(&workspace));
    expect(loewner_checker_classify(checker, workspace, configurations, COUNT, answers->verdicts[0]));
    expect(loewner_checker_collide(checker, workspace, configurations, COUNT, answers->verdicts[1]));
    expect(loewner_checker_certify_edges(checker, workspace, configurations, configurations + dof, COUNT - 1, NULL,
                                         answers->verdicts[2], NULL, NULL));
    int8_t is_free[COUNT];
    expect(loewner_checker_motions_free(checker, workspace, configurations, configurations + dof, COUNT - 1, NULL,
                                        is_free));
    for (int k = 0; k < COUNT - 1; k++)
        if (is_free[k] != (answers->verdicts[2][k] == LOEWNER_FREE))
            exit(3);
    expect(loewner_checker_distance(checker, workspace, configurations, COUNT, distances, gradients));
    answers->sum = 0;
    for (int k = 0; k < COUNT; k++)
        answers->sum += distances[k].distance;
    expect(loewner_checker_link_poses(checker, configurations, 1, poses));
    int8_t placed;
    expect(loewner_checker_collide_placed(checker, workspace, poses, &placed, NULL));
    if (placed != answers->verdicts[1][0])
        exit(2);
    int free_ones[2] = {-1, -1};
    for (int k = 0; k < COUNT && free_ones[1] < 0; k++)
        if (answers->verdicts[1][k] == LOEWNER_FREE)
            free_ones[free_ones[0] >= 0] = k;
    const double *path;
    size_t rows = 0;
    loewner_plan_options options = {.max_iterations = 300};
    if (free_ones[1] >= 0)
        loewner_checker_plan(checker, workspace, configurations + dof * free_ones[0],
                             configurations + dof * free_ones[1], 1, &options, &path, &rows);
    answers->length = (double)rows;
    loewner_workspace_free(workspace);
    free(gradients);
    free(poses);
    return NULL;
}

static Answers answers[THREADS];

static void round_of(int number)
{
    pthread_t threads[THREADS];
    for (int k = 0; k < THREADS; k++)
        if (pthread_create(&threads[k], NULL, ask, &answers[k]) != 0)
            exit(1);
    for (int k = 0; k < THREADS; k++)
        pthread_join(threads[k], NULL);
    for (int k = 1; k < THREADS; k++)
        if (memcmp(&answers[k], &answers[0], offsetof(Answers, gate)) != 0) {
            fprintf(stderr, "threads disagree in round %d\n", number);
            exit(2);
        }
    memcpy(first, answers[0].verdicts, sizeof first);
    lengths[number % 2] = answers[0].sum;
}

int main(int count, char **arguments)
{
    double pose[16] = {1, 0, 0, 0.3, 0, 1, 0, 0.1, 0, 0, 1, 0.6, 0, 0, 0, 1};
    const double in_hand[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.2, 0, 0, 0, 1};
    expect(loewner_checker_open(count > 1 ? arguments[1] : "cell.lwn", &checker));
    dof = loewner_checker_dof(checker);
    double *lower = calloc((size_t)dof, sizeof *lower), *upper = calloc((size_t)dof, sizeof *upper);
    configurations = calloc((size_t)(dof * COUNT), sizeof *configurations);
    expect(loewner_checker_limits(checker, lower, upper));
    for (int k = 0; k < dof * COUNT; k++)
        configurations[k] = lower[k % dof] + (upper[k % dof] - lower[k % dof]) * rand() / RAND_MAX;
    int32_t body = loewner_checker_body_count(checker) - 1, touch = loewner_checker_link_count(checker) - 1;
    double *limits = malloc(sizeof(double) * (size_t)dof);
    for (int c = 0; c < dof; c++)
        limits[c] = 5;
    const loewner_gate_options options = {.acceleration = limits, .jerk = limits};
    for (int k = 0; k < THREADS; k++)
        expect(loewner_gate_new(checker, &options, TARGETS, &answers[k].gate));
    expect(loewner_gate_new(checker, &options, 1, &shared));
    round_of(0);
    expect(loewner_checker_move(checker, &body, pose, 1));
    round_of(1);
    expect(loewner_checker_attach(checker, body, loewner_checker_link_count(checker) - 3, in_hand, &touch, 1));
    round_of(2);
    expect(loewner_checker_set_margin(checker, 0, body, 0.02));
    expect(loewner_checker_set_present(checker, body - 1, 0));
    round_of(3);
    expect(loewner_checker_detach(checker, body, pose));
    expect(loewner_checker_set_present(checker, body - 1, 1));
    round_of(4);
    const loewner_bounds bounds = {0.01, 0.01, 0.1, 0.1, 0.0};
    has_bounds = 1;
    expect(loewner_checker_set_bounds(checker, body, &bounds));
    round_of(5);
    expect(loewner_checker_move(checker, &body, pose, 1));
    round_of(6);
    for (int k = 0; k < THREADS; k++)
        loewner_gate_free(answers[k].gate);
    loewner_gate_free(shared);
    loewner_checker_close(checker);
    free(limits);
    free(configurations);
    free(lower);
    free(upper);
    puts("all threads agree");
    return 0;
}
