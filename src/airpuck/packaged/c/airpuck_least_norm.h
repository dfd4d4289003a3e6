/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Vectors of least norm, as the thrust allocation needs them:
 *
 *     min x'x   subject to   sum of x_j columns_j = wanted  and  lower <= x <= upper.
 *
 * There are three equations, however many motors there are. So the factor of the active set is
 * small enough to be made anew in every iteration, from the variables that are not at a bound. This
 * keeps a float's digits where the costs of thrusts and slacks differ by a factor of a million. */
#ifndef AIRPUCK_LEAST_NORM_H
#define AIRPUCK_LEAST_NORM_H

#include "airpuck_real.h"
#include "airpuck_sizes.h"

/* Thrusts, slacks and residuals of the equations. */
#define AIRPUCK_VARIABLES (AIRPUCK_MOTORS + 5)

typedef enum {
    AIRPUCK_LEAST_SOLVED,
    AIRPUCK_LEAST_INFEASIBLE,
    AIRPUCK_LEAST_ITERATION_LIMIT
} airpuck_least_status;

typedef struct {
    int n;
    airpuck_real columns[AIRPUCK_VARIABLES][3], wanted[3];
    airpuck_real lower[AIRPUCK_VARIABLES], upper[AIRPUCK_VARIABLES];
    airpuck_real x[AIRPUCK_VARIABLES];
    int iterations;
} airpuck_least_norm;

/* Solve a problem of finite numbers; only bounds may be infinite. Columns that differ much in size
 * should be sorted: the largest first. */
airpuck_least_status airpuck_least_norm_solve(airpuck_least_norm *p);

#endif
