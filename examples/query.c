/* Ask a robot's checker from C: python examples/save_cell.py cell.lwn, then ./query cell.lwn

   export PKG_CONFIG_PATH="$(loewner --pkg-config-dir)"
   eval cc examples/query.c "$(pkg-config --cflags --libs loewner)" -o query */

#include <loewner.h>
#include <stdio.h>
#include <stdlib.h>

static void expect(loewner_status status)
{
    if (status == LOEWNER_OK)
        return;
    fprintf(stderr, "%s: %s\n", loewner_status_name(status), loewner_error_text());
    exit(1);
}

int main(int count, char **arguments)
{
    loewner_checker *checker;
    loewner_workspace *workspace;
    expect(loewner_checker_open(count > 1 ? arguments[1] : "cell.lwn", &checker));
    expect(loewner_workspace_new(&workspace));

    int dof = loewner_checker_dof(checker);
    double *lower = calloc((size_t)dof, sizeof *lower), *upper = calloc((size_t)dof, sizeof *upper);
    double *start = calloc((size_t)dof, sizeof *start), *goal = calloc((size_t)dof, sizeof *goal);
    expect(loewner_checker_limits(checker, lower, upper));
    double *free_ones[] = {start, goal};
    for (int which = 0; which < 2; which++) {
        int8_t verdict;
        do {
            for (int k = 0; k < dof; k++) { /* joints without limits turn by half a turn either way */
                double low = lower[k] > -3.14 ? lower[k] : -3.14, high = upper[k] < 3.14 ? upper[k] : 3.14;
                free_ones[which][k] = low + (high - low) * rand() / RAND_MAX;
            }
            expect(loewner_checker_collide(checker, workspace, free_ones[which], 1, &verdict));
        } while (verdict != LOEWNER_FREE);
    }
    const double *path;
    size_t length;
    expect(loewner_checker_plan(checker, workspace, start, goal, 1, NULL, &path, &length));
    printf("a proven path of %zu configurations, %s\n", length, loewner_level());
    free(lower), free(upper), free(start), free(goal);
    loewner_workspace_free(workspace);
    loewner_checker_close(checker);
    return 0;
}
