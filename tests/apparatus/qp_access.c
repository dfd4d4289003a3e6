/* Access to the exported solver of quadratic programs, for the tests: arrays of doubles in, out. */
#include "airpuck_qp.h"

#include <stdlib.h>

int access_solve(int n, int r, int s, int most, double penalty, const double *hessian,
                 const double *gradient, const double *matrix, const double *lower,
                 const double *upper, signed char *state, double *x, double *multipliers,
                 int *iterations);

/* Solve a problem with a full Hessian in memory of exactly the stated size; also return the
 * multipliers in the units of the constraints. */
int access_solve(int n, int r, int s, int most, double penalty, const double *hessian,
                 const double *gradient, const double *matrix, const double *lower,
                 const double *upper, signed char *state, double *x, double *multipliers,
                 int *iterations)
{
    airpuck_qp qp;
    size_t count = (size_t)AIRPUCK_QP_NUMBERS(n, r, s), active = (size_t)AIRPUCK_QP_ACTIVE(n, s);
    airpuck_real *numbers = (airpuck_real *)malloc(count * sizeof *numbers);
    int *working = (int *)malloc(active * sizeof *working);
    airpuck_qp_begin(&qp, n, r, s, numbers, working, state);
    qp.iteration_limit = most;
    qp.penalty = (airpuck_real)penalty;
    for (int i = 0; i < n; i++) {
        qp.gradient[i] = (airpuck_real)gradient[i];
        for (int j = i; j < n; j++)
            qp.hessian[airpuck_qp_row(n, i) + j - i] = (airpuck_real)hessian[i * n + j];
    }
    for (int i = 0; i < r * n; i++)
        qp.matrix[i] = (airpuck_real)matrix[i];
    for (int i = 0; i < n + r; i++) {
        qp.lower[i] = (airpuck_real)lower[i];
        qp.upper[i] = (airpuck_real)upper[i];
        multipliers[i] = 0;
    }
    int status = (int)airpuck_qp_solve(&qp);
    for (int i = 0; i < n; i++)
        x[i] = (double)qp.x[i];
    for (int j = 0; j < qp.active; j++)
        multipliers[working[j]] = (double)(qp.dual[j] * qp.scale[working[j]]);
    *iterations = qp.iterations;
    free(numbers);
    free(working);
    return status;
}
