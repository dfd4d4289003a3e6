/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Vectors of least norm, as the thrust allocation needs them:
 *
 *     min x'x   subject to   sum of x_j columns_j = wanted  and  lower <= x <= upper.
 *
 * There are three equations, however many motors there are. So the factor of the active set is
 * small enough to be made anew in every iteration, from the variables that are not at a bound.
 *
 * All numbers are double, also in single precision: slacks cost a million times as much as thrusts,
 * and a float has no digits for both. */
#ifndef AIRPUCK_LEAST_NORM_H
#define AIRPUCK_LEAST_NORM_H

#include "airpuck_sizes.h"

/* Thrusts, slacks and residuals of the equations. */
#define AIRPUCK_VARIABLES (AIRPUCK_MOTORS + 5)

typedef enum {
    AIRPUCK_LEAST_SOLVED,
    AIRPUCK_LEAST_INFEASIBLE,
    AIRPUCK_LEAST_ITERATION_LIMIT
} airpuck_least_status;

/* Sides of variables: free, at a bound, or at two equal bounds. */
enum {
    AIRPUCK_LEAST_FREE = 0,
    AIRPUCK_LEAST_AT_LOWER = 1,
    AIRPUCK_LEAST_AT_UPPER = -1,
    AIRPUCK_LEAST_FIXED = 2
};

typedef struct {
    int n;
    double columns[AIRPUCK_VARIABLES][3], wanted[3];
    double lower[AIRPUCK_VARIABLES], upper[AIRPUCK_VARIABLES];
    double x[AIRPUCK_VARIABLES];
    /* Sides of the variables. The solver starts from those it finds, all free or the last ones. */
    signed char side[AIRPUCK_VARIABLES];
    int iterations;
} airpuck_least_norm;

/* Solve a problem of finite numbers; only bounds may be infinite. Columns that differ much in size
 * should be sorted: the largest first. */
airpuck_least_status airpuck_least_norm_solve(airpuck_least_norm *p);

#endif
