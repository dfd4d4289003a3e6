/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_least_norm.h"

#include <string.h>

#define MOST AIRPUCK_VARIABLES
#ifdef AIRPUCK_SINGLE
/* Relative error within which a bound is met and an equation holds; of a multiplier's sign; and of
 * an equation that depends on the others. */
#define MET AIRPUCK_R(1e-6)
#define SIGNED AIRPUCK_R(4e-6)
#define DEPENDENT AIRPUCK_R(2e-6)
#else
#define MET AIRPUCK_R(1e-12)
#define SIGNED AIRPUCK_R(1e-14)
#define DEPENDENT AIRPUCK_R(1e-12)
#endif

/* Sides of variables: free, at a bound, or at two equal bounds. */
enum { FREE = 0, AT_LOWER = 1, AT_UPPER = -1, FIXED = 2 };

/* The transposed columns of the free variables, factored by Householder's reflections; and what
 * follows from them. */
typedef struct {
    int count, rank, variables[MOST], order[3];
    airpuck_real rows[3][MOST], reflectors[3][MOST], strength[3];
    airpuck_real price[3];   /* Multipliers of the equations. */
    airpuck_real missing[3]; /* If they cannot hold: a direction for the multipliers. */
    int consistent;
} factored;

static airpuck_real square(int count, const airpuck_real *a)
{
    airpuck_real sum = 0;
    for (int i = 0; i < count; i++)
        sum += a[i] * a[i];
    return sum;
}

/* Reflect a vector, from its entry k on. */
static void reflect(const factored *f, int k, airpuck_real *y)
{
    const airpuck_real *v = f->reflectors[k];
    airpuck_real along = 0;
    for (int i = k; i < f->count; i++)
        along += v[i] * y[i];
    along *= f->strength[k];
    for (int i = k; i < f->count; i++)
        y[i] -= along * v[i];
}

/* Factor the equations of the free variables, the largest first; those that depend on the others
 * come last. */
static void factor(const airpuck_least_norm *p, const signed char side[MOST], factored *f)
{
    airpuck_real whole[3];
    f->count = 0;
    for (int j = 0; j < p->n; j++)
        if (side[j] == FREE) {
            for (int axis = 0; axis < 3; axis++)
                f->rows[axis][f->count] = p->columns[j][axis];
            f->variables[f->count++] = j;
        }
    for (int axis = 0; axis < 3; axis++) {
        f->order[axis] = axis;
        whole[axis] = square(f->count, f->rows[axis]);
    }
    for (f->rank = 0; f->rank < 3 && f->rank < f->count; f->rank++) {
        int k = f->rank, chosen = -1;
        airpuck_real largest = 0;
        for (int i = k; i < 3; i++) {
            int axis = f->order[i];
            airpuck_real left = square(f->count - k, f->rows[axis] + k);
            if (left > DEPENDENT * DEPENDENT * whole[axis] && left > largest) {
                largest = left;
                chosen = i;
            }
        }
        if (chosen < 0)
            return;
        int axis = f->order[chosen];
        f->order[chosen] = f->order[k];
        f->order[k] = axis;
        memcpy(f->reflectors[k], f->rows[axis], sizeof f->rows[axis]);
        airpuck_real length = AIRPUCK_F(sqrt)(largest);
        f->reflectors[k][k] += f->rows[axis][k] < 0 ? -length : length;
        f->strength[k] = 2 / square(f->count - k, f->reflectors[k] + k);
        for (int i = k; i < 3; i++)
            reflect(f, k, f->rows[f->order[i]]);
    }
}

/* Solve R z = y for the leading equations, given the other entries of z. */
static void solve_upper(const factored *f, const airpuck_real y[3], airpuck_real z[3])
{
    for (int k = f->rank - 1; k >= 0; k--) {
        airpuck_real sum = y[k];
        for (int after = k + 1; after < 3; after++)
            sum -= f->rows[f->order[after]][k] * z[f->order[after]];
        z[f->order[k]] = sum / f->rows[f->order[k]][k];
    }
}

/* Set the free variables and the prices with the others at their bounds. If the equations cannot
 * hold, set the direction of prices that shows it. */
static void solve_free(airpuck_least_norm *p, const signed char side[MOST], factored *f)
{
    static const airpuck_real zeros[3] = {0, 0, 0};
    airpuck_real rest[3], size[3], y[MOST] = {0};
    for (int axis = 0; axis < 3; axis++) {
        rest[axis] = p->wanted[axis];
        size[axis] = AIRPUCK_F(fabs)(rest[axis]);
    }
    for (int j = 0; j < p->n; j++) {
        if (side[j] == FREE)
            continue;
        p->x[j] = side[j] == AT_UPPER ? p->upper[j] : p->lower[j];
        for (int axis = 0; axis < 3; axis++) {
            airpuck_real part = p->columns[j][axis] * p->x[j];
            rest[axis] -= part;
            size[axis] += AIRPUCK_F(fabs)(part);
        }
    }
    factor(p, side, f);
    f->consistent = 1;
    for (int i = 0; i < 3; i++) {
        int axis = f->order[i];
        airpuck_real sum = rest[axis], scale = size[axis];
        for (int before = 0; before < i && before < f->rank; before++) {
            airpuck_real part = f->rows[axis][before] * y[before];
            sum -= part;
            scale += AIRPUCK_F(fabs)(part);
        }
        f->price[axis] = f->missing[axis] = 0;
        if (i < f->rank) {
            y[i] = sum / f->rows[axis][i];
        } else if (AIRPUCK_F(fabs)(sum) > MET * scale) {
            f->missing[axis] = sum;
            f->consistent = 0;
        }
    }
    if (!f->consistent)
        solve_upper(f, zeros, f->missing);
    solve_upper(f, y, f->price);
    for (int k = f->rank - 1; k >= 0; k--)
        reflect(f, k, y);
    for (int i = 0; i < f->count; i++)
        p->x[f->variables[i]] = y[i];
}

/* Return number - columns_j' prices, or 0 if rounding decides its sign. */
static airpuck_real difference(const airpuck_least_norm *p, int j, airpuck_real number,
                               const airpuck_real prices[3])
{
    airpuck_real result = number, size = AIRPUCK_F(fabs)(number);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real part = p->columns[j][axis] * prices[axis];
        result -= part;
        size += AIRPUCK_F(fabs)(part);
    }
    return AIRPUCK_F(fabs)(result) > SIGNED * size ? result : 0;
}

/* Move the multipliers of the bounds along a direction, at most to `limit`, until one of them is
 * zero; return its variable, or -1. */
static int advance(const airpuck_least_norm *p, const signed char side[MOST],
                   const airpuck_real direction[MOST], airpuck_real limit,
                   airpuck_real multiplier[MOST])
{
    int stopped = -1;
    for (int j = 0; j < p->n; j++) {
        airpuck_real rate = (airpuck_real)side[j] * direction[j];
        airpuck_real size = (airpuck_real)side[j] * multiplier[j];
        if ((side[j] == AT_LOWER || side[j] == AT_UPPER) && rate < 0 && size < -rate * limit) {
            limit = size > 0 ? size / -rate : 0;
            stopped = j;
        }
    }
    for (int j = 0; j < p->n && limit < INFINITY; j++)
        multiplier[j] += limit * direction[j];
    return stopped;
}

/* Return the free variable that is furthest beyond a bound, or -1; set its side. */
static int violated(const airpuck_least_norm *p, signed char side[MOST])
{
    int worst = -1;
    airpuck_real most = MET;
    for (int j = 0; j < p->n; j++) {
        airpuck_real low = p->lower[j] - p->x[j], high = p->x[j] - p->upper[j];
        airpuck_real size = AIRPUCK_F(fabs)(p->lower[j]) + AIRPUCK_F(fabs)(p->upper[j]);
        if (side[j] == FREE && (low > high ? low : high) > most * size) {
            most = (low > high ? low : high) / size;
            worst = j;
        }
    }
    if (worst >= 0)
        side[worst] = p->x[worst] < p->lower[worst] ? AT_LOWER : AT_UPPER;
    return worst;
}

airpuck_least_status airpuck_least_norm_solve(airpuck_least_norm *p)
{
    signed char side[MOST];
    airpuck_real multiplier[MOST] = {0}, direction[MOST];
    factored f;
    for (int j = 0; j < p->n; j++) {
        if (!(p->lower[j] <= p->upper[j]))
            return AIRPUCK_LEAST_INFEASIBLE;
        side[j] = p->lower[j] < p->upper[j] ? FREE : FIXED;
    }
    /* Three to five iterations are usual. */
    for (p->iterations = 1; p->iterations <= 20 * MOST; p->iterations++) {
        solve_free(p, side, &f);
        for (int j = 0; j < p->n; j++) {
            direction[j] = 0;
            if (side[j] == FREE)
                continue;
            direction[j] = f.consistent ? difference(p, j, p->x[j], f.price) - multiplier[j]
                                        : difference(p, j, 0, f.missing);
        }
        int stopped = advance(p, side, direction, f.consistent ? 1 : INFINITY, multiplier);
        if (stopped >= 0) {
            side[stopped] = FREE;
            multiplier[stopped] = 0;
        } else if (!f.consistent) {
            return AIRPUCK_LEAST_INFEASIBLE;
        } else if (violated(p, side) < 0) {
            return AIRPUCK_LEAST_SOLVED;
        }
    }
    return AIRPUCK_LEAST_ITERATION_LIMIT;
}
