/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Strictly convex quadratic programs, solved in the caller's memory by a dual active-set method.
 *
 *     min x'Hx/2 + f'x   subject to   lower <= (x, Ax) <= upper
 *
 * The first constraints are the bounds of the variables, the others the rows of A. The last `soft`
 * rows may be violated: a violation e costs penalty * (e + e^2/2). docs/exported_qp.md derives the
 * method. */
#ifndef AIRPUCK_QP_H
#define AIRPUCK_QP_H

#include "airpuck_real.h"

/* Maximum number of active constraints, for n variables and s soft rows. */
#define AIRPUCK_QP_ACTIVE(n, s) ((n) + (s) + 1)
/* Length of the array `numbers` for n variables and r rows, s of them soft. */
#define AIRPUCK_QP_NUMBERS(n, r, s)                                                              \
    ((n) * ((n) + 1) / 2 + (r) * (n) + 3 * ((n) + (r)) + 3 * (n) +                                \
     AIRPUCK_QP_ACTIVE(n, s) * (AIRPUCK_QP_ACTIVE(n, s) + 7) / 2)

typedef enum {
    AIRPUCK_QP_SOLVED,          /* x is the solution, within all limits. */
    AIRPUCK_QP_SOFTENED,        /* x is the solution; it violates a soft row. */
    AIRPUCK_QP_INEXACT,         /* Rounding keeps x from its active limits by more than allowed. */
    AIRPUCK_QP_INFEASIBLE,      /* No x satisfies the constraints that are not soft. */
    AIRPUCK_QP_ITERATION_LIMIT, /* Not solved within the iteration limit. */
    AIRPUCK_QP_NOT_CONVEX,      /* H is not positive definite. */
    AIRPUCK_QP_NOT_FINITE       /* A number of the problem or its solution is not finite, or the
                                   penalty is not positive. */
} airpuck_qp_status;

/* How a constraint takes part in the solution. The sign of its multiplier is the sign of the state;
 * a soft row beyond its limit has a multiplier above the penalty. */
enum {
    AIRPUCK_QP_INACTIVE = 0,
    AIRPUCK_QP_AT_LOWER = 1,
    AIRPUCK_QP_AT_UPPER = -1,
    AIRPUCK_QP_BEYOND_LOWER = 2,
    AIRPUCK_QP_BEYOND_UPPER = -2,
    AIRPUCK_QP_EQUALITY = 3,
    AIRPUCK_QP_REDUNDANT = 4 /* An equality whose normal depends on the active ones. */
};

/* A problem. Its arrays lie in the caller's memory, so it lives only during one control step. */
typedef struct {
    int n, rows, soft; /* Sizes: variables, rows of A, soft ones among them. */
    int iteration_limit;
    airpuck_real penalty; /* Of soft rows; positive. */

    /* To be filled in by the caller; the solver overwrites them. H is its upper triangle, row by
     * row; A is stored row by row. */
    airpuck_real *hessian, *gradient, *matrix, *lower, *upper;

    /* The result; x is defined only if the problem is solved. `dual` belongs to the active
     * constraints in `working`, in scaled units. */
    airpuck_real *x, *dual;
    int *working, active, iterations;
    /* State of each constraint: the solver starts from the one it finds here. */
    signed char *state;

    /* Memory of the solver; `factor` is the caller's until the problem is solved. */
    airpuck_real *scale, *residual, *target, *column, *factor;
} airpuck_qp;

/* Lay out a problem. `numbers` has AIRPUCK_QP_NUMBERS(n, r, s) entries, `working` has
 * AIRPUCK_QP_ACTIVE(n, s), and `state` has n + r. */
void airpuck_qp_begin(airpuck_qp *qp, int n, int r, int s, airpuck_real *numbers, int *working,
                      signed char *state);

/* Return the position of row i of the Hessian's upper triangle. */
int airpuck_qp_row(int n, int i);

/* Solve the problem. */
airpuck_qp_status airpuck_qp_solve(airpuck_qp *qp);

#endif
