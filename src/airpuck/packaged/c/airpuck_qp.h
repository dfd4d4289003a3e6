/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Quadratic programs with a positive definite Hessian, solved by DAQP in the caller's memory.
 *
 *     min x'Hx/2 + f'x   subject to   lower <= (x, Ax) <= upper
 *
 * The first bounds are those of the variables. DAQP's solver is unchanged (folder daqp);
 * airpuck_qp.c replaces the parts of DAQP that allocate memory. */
#ifndef AIRPUCK_QP_H
#define AIRPUCK_QP_H

#include "airpuck_real.h"

#ifdef AIRPUCK_SINGLE
#define DAQP_SINGLE_PRECISION
#endif
#include "daqp/daqp.h"

/* Maximum number of active constraints, for n variables and s soft rows. */
#define AIRPUCK_QP_ACTIVE(n, s) ((n) + (s) + 1)
/* Length of the array `numbers` for n variables and r rows. */
#define AIRPUCK_QP_NUMBERS(n, r, s)                                                              \
    ((n) * ((n) + 1) / 2 + (r) * (n) + 5 * ((n) + (r)) + 3 * (n) + (r) +                          \
     AIRPUCK_QP_ACTIVE(n, s) * (AIRPUCK_QP_ACTIVE(n, s) + 11) / 2)

/* A problem. Its arrays lie in the caller's memory, so it lives only during one control step. */
typedef struct {
    DAQPWorkspace work;
    DAQPProblem problem;
    DAQPSettings settings;
    /* To be filled in by the caller: bounds, gradient f, and the upper triangle of H row by row. */
    airpuck_real *lower, *upper, *gradient, *hessian;
    /* Free memory until airpuck_qp_solve. */
    airpuck_real *scratch;
} airpuck_qp;

/* Lay out a problem of n variables and r rows, s of them soft.
 *
 * `rows` is A, or NULL to have it in qp->work.M, where the solver overwrites it. `sense` holds the
 * kinds of the constraints (see daqp/types.h) and, after a solution, the active ones: passing it on
 * starts the next problem from there. `active` has AIRPUCK_QP_ACTIVE(n, s) entries. */
void airpuck_qp_begin(airpuck_qp *qp, int n, int r, int s, airpuck_real *rows,
                      airpuck_real *numbers, int *active, int *sense);

/* Factor H = 2I, which ignores `hessian`, with f = 0. */
void airpuck_qp_factor_twice_identity(airpuck_qp *qp);

/* Factor H in its place; return whether it is positive definite. */
int airpuck_qp_factor(airpuck_qp *qp);

/* For a problem without rows: return whether the unconstrained minimum meets all bounds of the
 * variables; work.x is then the solution. Call this between factoring and solving. */
int airpuck_qp_unconstrained(airpuck_qp *qp);

/* Solve; return DAQP's exit flag, positive if work.x is the solution. */
int airpuck_qp_solve(airpuck_qp *qp);

#endif
