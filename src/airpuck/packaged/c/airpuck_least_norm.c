/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_least_norm.h"

#include <math.h>
#include <string.h>

#define MOST AIRPUCK_VARIABLES
/* Relative errors: within MET a bound is met and an equation holds; within SIGNED a multiplier is
 * zero; within DEPENDENT an equation depends on the others. */
#define MET 1e-12
#define SIGNED 1e-14
#define DEPENDENT 1e-12

enum {
    FREE = AIRPUCK_LEAST_FREE,
    AT_LOWER = AIRPUCK_LEAST_AT_LOWER,
    AT_UPPER = AIRPUCK_LEAST_AT_UPPER,
    FIXED = AIRPUCK_LEAST_FIXED
};

/* The transposed columns of the free variables, factored by Householder's reflections; and what
 * follows from them. */
typedef struct {
    int count, rank, variables[MOST], order[3];
    double rows[3][MOST], reflectors[3][MOST], strength[3];
    double multipliers[3]; /* Of the equations. */
    double missing[3];     /* If the equations cannot hold: a direction of their multipliers. */
    int consistent;
} factored;

static double square(int count, const double *a)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += a[i] * a[i];
    return sum;
}

/* Reflect a vector, from its entry k on. */
static void reflect(const factored *f, int k, double *y)
{
    const double *v = f->reflectors[k];
    double along = 0;
    for (int i = k; i < f->count; i++)
        along += v[i] * y[i];
    along *= f->strength[k];
    for (int i = k; i < f->count; i++)
        y[i] -= along * v[i];
}

/* Factor the equations of the free variables, the largest first; those that depend on the others
 * come last. */
static void factor(const airpuck_least_norm *p, factored *f)
{
    double whole[3];
    f->count = 0;
    for (int j = 0; j < p->n; j++)
        if (p->side[j] == FREE) {
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
        double largest = 0;
        for (int i = k; i < 3; i++) {
            int axis = f->order[i];
            double left = square(f->count - k, f->rows[axis] + k);
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
        double length = sqrt(largest);
        f->reflectors[k][k] += f->rows[axis][k] < 0 ? -length : length;
        f->strength[k] = 2 / square(f->count - k, f->reflectors[k] + k);
        for (int i = k; i < 3; i++)
            reflect(f, k, f->rows[f->order[i]]);
    }
}

/* Solve R z = y for the leading equations, given the other entries of z. */
static void solve_upper(const factored *f, const double y[3], double z[3])
{
    for (int k = f->rank - 1; k >= 0; k--) {
        double sum = y[k];
        for (int after = k + 1; after < 3; after++)
            sum -= f->rows[f->order[after]][k] * z[f->order[after]];
        z[f->order[k]] = sum / f->rows[f->order[k]][k];
    }
}

/* Set the free variables and the multipliers with the others at their bounds. If the equations
 * cannot hold, set the direction of multipliers that shows it. */
static void solve_free(airpuck_least_norm *p, factored *f)
{
    static const double zeros[3] = {0, 0, 0};
    double rest[3], size[3], y[MOST] = {0};
    for (int axis = 0; axis < 3; axis++) {
        rest[axis] = p->wanted[axis];
        size[axis] = fabs(rest[axis]);
    }
    for (int j = 0; j < p->n; j++) {
        if (p->side[j] == FREE)
            continue;
        p->x[j] = p->side[j] == AT_UPPER ? p->upper[j] : p->lower[j];
        for (int axis = 0; axis < 3; axis++) {
            double part = p->columns[j][axis] * p->x[j];
            rest[axis] -= part;
            size[axis] += fabs(part);
        }
    }
    factor(p, f);
    f->consistent = 1;
    for (int i = 0; i < 3; i++) {
        int axis = f->order[i];
        double sum = rest[axis], scale = size[axis];
        for (int before = 0; before < i && before < f->rank; before++) {
            double part = f->rows[axis][before] * y[before];
            sum -= part;
            scale += fabs(part);
        }
        f->multipliers[axis] = f->missing[axis] = 0;
        if (i < f->rank) {
            y[i] = sum / f->rows[axis][i];
        } else if (fabs(sum) > MET * scale) {
            f->missing[axis] = sum;
            f->consistent = 0;
        }
    }
    if (!f->consistent)
        solve_upper(f, zeros, f->missing);
    solve_upper(f, y, f->multipliers);
    for (int k = f->rank - 1; k >= 0; k--)
        reflect(f, k, y);
    for (int i = 0; i < f->count; i++)
        p->x[f->variables[i]] = y[i];
}

/* Return number - column_j' multipliers, or 0 if rounding decides its sign. */
static double difference(const airpuck_least_norm *p, int j, double number,
                         const double multipliers[3])
{
    double result = number, size = fabs(number);
    for (int axis = 0; axis < 3; axis++) {
        double part = p->columns[j][axis] * multipliers[axis];
        result -= part;
        size += fabs(part);
    }
    return fabs(result) > SIGNED * size ? result : 0;
}

/* Move the multipliers of the bounds along a direction, at most to `limit`, until one of them is
 * zero; return its variable, or -1. */
static int advance(const airpuck_least_norm *p, const double direction[MOST], double limit,
                   double multiplier[MOST])
{
    int stopped = -1;
    for (int j = 0; j < p->n; j++) {
        double rate = (double)p->side[j] * direction[j];
        double size = (double)p->side[j] * multiplier[j];
        if ((p->side[j] == AT_LOWER || p->side[j] == AT_UPPER) && rate < 0 && size < -rate * limit) {
            limit = size > 0 ? size / -rate : 0;
            stopped = j;
        }
    }
    for (int j = 0; j < p->n && limit < (double)INFINITY; j++)
        multiplier[j] += limit * direction[j];
    return stopped;
}

/* Return the free variable that is furthest beyond a bound, or -1; set its side. */
static int violated(airpuck_least_norm *p)
{
    int worst = -1;
    double most = MET;
    for (int j = 0; j < p->n; j++) {
        double low = p->lower[j] - p->x[j], high = p->x[j] - p->upper[j];
        double size = fabs(p->lower[j]) + fabs(p->upper[j]);
        if (p->side[j] == FREE && (low > high ? low : high) > most * size) {
            most = (low > high ? low : high) / size;
            worst = j;
        }
    }
    if (worst >= 0)
        p->side[worst] = p->x[worst] < p->lower[worst] ? AT_LOWER : AT_UPPER;
    return worst;
}

airpuck_least_status airpuck_least_norm_solve(airpuck_least_norm *p)
{
    double multiplier[MOST] = {0}, target[MOST], direction[MOST];
    factored f;
    for (int j = 0; j < p->n; j++)
        p->x[j] = 0;
    for (int j = 0; j < p->n; j++) {
        if (!(p->lower[j] <= p->upper[j]))
            return AIRPUCK_LEAST_INFEASIBLE;
        int fixed = !(p->lower[j] < p->upper[j]), was = p->side[j];
        int bounded = isfinite(was == AT_LOWER ? p->lower[j] : p->upper[j]);
        if (fixed || (was != AT_LOWER && was != AT_UPPER) || !bounded)
            p->side[j] = fixed ? FIXED : FREE;
    }
    /* Three to ten iterations are usual. */
    for (p->iterations = 1; p->iterations <= 20 * MOST; p->iterations++) {
        solve_free(p, &f);
        for (int j = 0; j < p->n; j++) {
            target[j] = p->side[j] == FREE ? 0 : difference(p, j, p->x[j], f.multipliers);
            direction[j] = target[j] - multiplier[j];
            if (!f.consistent)
                direction[j] = p->side[j] == FREE ? 0 : difference(p, j, 0, f.missing);
        }
        int stopped = advance(p, direction, f.consistent ? 1 : (double)INFINITY, multiplier);
        if (stopped >= 0) {
            p->side[stopped] = FREE;
            multiplier[stopped] = 0;
            continue;
        }
        if (!f.consistent)
            return AIRPUCK_LEAST_INFEASIBLE;
        memcpy(multiplier, target, sizeof multiplier);
        if (violated(p) < 0)
            return AIRPUCK_LEAST_SOLVED;
    }
    return AIRPUCK_LEAST_ITERATION_LIMIT;
}
