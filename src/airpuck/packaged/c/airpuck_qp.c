/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_qp.h"

#include <float.h>
#include <string.h>

#ifdef AIRPUCK_SINGLE
#define ROUNDING FLT_EPSILON
/* Relative violation below which a constraint counts as met. */
#define FEASIBLE AIRPUCK_R(2e-5)
/* Relative error of an active limit, after refinement, above which the solution is inexact. */
#define INEXACT AIRPUCK_R(2e-3)
/* Squared distance of a unit normal from the span of the others below which it depends on them. */
#define DEPENDENT AIRPUCK_R(1e-6)
#else
#define ROUNDING DBL_EPSILON
#define FEASIBLE AIRPUCK_R(1e-12)
#define INEXACT AIRPUCK_R(1e-9)
#define DEPENDENT AIRPUCK_R(1e-14)
#endif
/* Squared distance below which cancellation makes it inaccurate; it is then computed again. */
#define CANCELLED AIRPUCK_R(1e-2)
/* Iterations, for each constraint, that suggest a cycle. */
#define CYCLING 2
/* Steps of iterative refinement, at most, for one active set. */
#define REFINEMENTS 3

static airpuck_real dot(int count, const airpuck_real *a, const airpuck_real *b)
{
    airpuck_real sum = 0;
    for (int i = 0; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

static airpuck_real larger(airpuck_real a, airpuck_real b)
{
    return a > b ? a : b;
}

/* Add a multiple of a to b. */
static void accumulate(int count, airpuck_real factor, const airpuck_real *a, airpuck_real *b)
{
    for (int i = 0; i < count; i++)
        b[i] += factor * a[i];
}

static int all_finite(int count, const airpuck_real *numbers)
{
    airpuck_real sum = 0;
    for (int i = 0; i < count; i++)
        sum += numbers[i] - numbers[i];
    return sum == 0;
}

int airpuck_qp_row(int n, int i)
{
    return i * (2 * n - i + 1) / 2;
}

void airpuck_qp_begin(airpuck_qp *qp, int n, int r, int s, airpuck_real *numbers, int *working,
                      signed char *state)
{
    int m = n + r, k = AIRPUCK_QP_ACTIVE(n, s);
    memset(qp, 0, sizeof *qp);
    qp->n = n;
    qp->rows = r;
    qp->soft = s;
    qp->working = working;
    qp->state = state;
    qp->hessian = numbers;
    qp->matrix = qp->hessian + n * (n + 1) / 2;
    qp->lower = qp->matrix + r * n;
    qp->upper = qp->lower + m;
    qp->scale = qp->upper + m;
    qp->gradient = qp->scale + m;
    qp->x = qp->gradient + n;
    qp->residual = qp->x + n;
    qp->dual = qp->residual + n;
    qp->target = qp->dual + k;
    qp->column = qp->target + k;
    qp->factor = qp->column + k;
    memset(qp->x, 0, (size_t)n * sizeof *qp->x);
}

/* ---- The least-distance problem: u = Rx + v with H = R'R and v = inv(R)'f, so that the cost is
 * u'u/2 and constraint i is lower <= m'u <= upper with a unit normal m. */

/* Replace H by the upper triangular R; return whether H is positive definite. */
static int factor_hessian(airpuck_qp *qp)
{
    int n = qp->n;
    for (int i = 0; i < n; i++) {
        airpuck_real *row = qp->hessian + airpuck_qp_row(n, i), diagonal = row[0];
        for (int k = 0; k < i; k++) {
            const airpuck_real *before = qp->hessian + airpuck_qp_row(n, k) + i - k;
            accumulate(n - i, -before[0], before, row);
        }
        if (!(row[0] > (airpuck_real)n * ROUNDING * diagonal))
            return 0;
        airpuck_real reciprocal = 1 / AIRPUCK_F(sqrt)(row[0]);
        for (int j = 0; j < n - i; j++)
            row[j] *= reciprocal;
    }
    return 1;
}

/* Multiply a row vector by inv(R), of which the rows from `first` on are known; the vector begins
 * with the entry `first`. Commands of late steps leave early limits alone, hence the zeros. */
static void multiply_by_inverse(const airpuck_qp *qp, int first, airpuck_real *vector)
{
    for (int k = qp->n - 1; k >= first; k--) {
        const airpuck_real *inverse = qp->hessian + airpuck_qp_row(qp->n, k);
        airpuck_real entry = vector[k - first];
        if (entry == 0)
            continue;
        vector[k - first] = entry * inverse[0];
        accumulate(qp->n - k - 1, entry, inverse + 1, vector + k - first + 1);
    }
}

/* Replace R by its inverse. */
static void invert_factor(airpuck_qp *qp)
{
    int n = qp->n;
    for (int i = n - 1; i >= 0; i--) {
        airpuck_real *row = qp->hessian + airpuck_qp_row(n, i);
        multiply_by_inverse(qp, i + 1, row + 1);
        row[0] = 1 / row[0];
        for (int j = 1; j < n - i; j++)
            row[j] *= -row[0];
    }
}

/* Return the normal of a constraint, from its entry `first` on; those before are zero. */
static airpuck_real *normal(const airpuck_qp *qp, int i, int *first)
{
    *first = i < qp->n ? i : 0;
    return i < qp->n ? qp->hessian + airpuck_qp_row(qp->n, i) : qp->matrix + (i - qp->n) * qp->n;
}

/* Return the product of a constraint's normal with a vector. */
static airpuck_real dot_normal(const airpuck_qp *qp, int i, const airpuck_real *vector)
{
    int first;
    const airpuck_real *m = normal(qp, i, &first);
    return dot(qp->n - first, m, vector + first);
}

/* Add a multiple of a constraint's normal to a vector. */
static void add_normal(const airpuck_qp *qp, int i, airpuck_real factor, airpuck_real *vector)
{
    int first;
    const airpuck_real *m = normal(qp, i, &first);
    accumulate(qp->n - first, factor, m, vector + first);
}

static int is_soft(const airpuck_qp *qp, int i)
{
    return i >= qp->n + qp->rows - qp->soft;
}

/* Scale normal and bounds of a constraint, and decide whether it is an equality. Return whether any
 * u can satisfy it. */
static int transform_constraint(airpuck_qp *qp, int i)
{
    int first, count;
    airpuck_real *m = normal(qp, i, &first), largest = 0;
    count = qp->n - first;
    for (int j = 0; j < count; j++)
        largest = larger(largest, AIRPUCK_F(fabs)(m[j]));
    int soft = is_soft(qp, i), equal = !soft && qp->lower[i] == qp->upper[i];
    if (qp->lower[i] > qp->upper[i])
        return 0;
    if (largest == 0) {
        /* The row is zero and constrains nothing. */
        qp->scale[i] = 0;
        qp->state[i] = AIRPUCK_QP_INACTIVE;
        return soft || (qp->lower[i] <= 0 && qp->upper[i] >= 0);
    }
    for (int j = 0; j < count; j++)
        m[j] /= largest;
    airpuck_real length = AIRPUCK_F(sqrt)(dot(count, m, m));
    for (int j = 0; j < count; j++)
        m[j] /= length;
    qp->scale[i] = 1 / largest / length;
    airpuck_real shift = dot(count, m, qp->gradient + first);
    qp->lower[i] = qp->lower[i] * qp->scale[i] + shift;
    qp->upper[i] = qp->upper[i] * qp->scale[i] + shift;
    /* Whatever state the caller left is a start, if it makes sense. */
    int side = qp->state[i] > 0 ? 1 : -1;
    if (equal)
        qp->state[i] = AIRPUCK_QP_EQUALITY;
    else if (qp->state[i] < AIRPUCK_QP_BEYOND_UPPER || qp->state[i] > AIRPUCK_QP_BEYOND_LOWER ||
             !isfinite(side > 0 ? qp->lower[i] : qp->upper[i]))
        qp->state[i] = AIRPUCK_QP_INACTIVE;
    else if (qp->state[i] != AIRPUCK_QP_INACTIVE && !soft)
        qp->state[i] = (signed char)side;
    return 1;
}

/* Transform the problem to the least-distance problem. */
static airpuck_qp_status transform(airpuck_qp *qp)
{
    int n = qp->n, m = qp->n + qp->rows;
    if (qp->soft > 0 && !(qp->penalty > 0 && qp->penalty < INFINITY))
        return AIRPUCK_QP_NOT_FINITE;
    if (!all_finite(n * (n + 1) / 2, qp->hessian) || !all_finite(n, qp->gradient) ||
        !all_finite(qp->rows * n, qp->matrix))
        return AIRPUCK_QP_NOT_FINITE;
    for (int i = 0; i < m; i++)
        if (!(qp->lower[i] < INFINITY) || !(qp->upper[i] > -INFINITY))
            return AIRPUCK_QP_NOT_FINITE;
    if (!factor_hessian(qp))
        return AIRPUCK_QP_NOT_CONVEX;
    invert_factor(qp);
    multiply_by_inverse(qp, 0, qp->gradient);
    for (int r = 0; r < qp->rows; r++)
        multiply_by_inverse(qp, 0, qp->matrix + r * n);
    for (int i = 0; i < m; i++)
        if (!transform_constraint(qp, i))
            return AIRPUCK_QP_INFEASIBLE;
    return AIRPUCK_QP_SOLVED;
}

/* ---- The active constraints. A soft row beyond its limit has the multiplier threshold +
 * e/compliance; its normal is extended by sqrt(compliance) in a dimension of its own. The upper
 * triangular F satisfies F'F = N'N for the extended normals N; it is stored column by column. */

static int is_beyond(const airpuck_qp *qp, int i)
{
    return qp->state[i] == AIRPUCK_QP_BEYOND_LOWER || qp->state[i] == AIRPUCK_QP_BEYOND_UPPER;
}

static airpuck_real sign(const airpuck_qp *qp, int i)
{
    return qp->state[i] < 0 ? AIRPUCK_R(-1.0) : AIRPUCK_R(1.0);
}

/* Multiplier at which a row gives way, without its sign. */
static airpuck_real threshold(const airpuck_qp *qp, int i)
{
    return is_soft(qp, i) ? qp->penalty / qp->scale[i] : INFINITY;
}

static airpuck_real compliance(const airpuck_qp *qp, int i)
{
    return is_beyond(qp, i) ? qp->scale[i] * qp->scale[i] / qp->penalty : 0;
}

static airpuck_real *factor_column(const airpuck_qp *qp, int j)
{
    return qp->factor + j * (j + 1) / 2;
}

/* Solve F'y = y in place. */
static void solve_transposed(const airpuck_qp *qp, airpuck_real *y)
{
    for (int j = 0; j < qp->active; j++) {
        const airpuck_real *column = factor_column(qp, j);
        y[j] = (y[j] - dot(j, column, y)) / column[j];
    }
}

/* Solve Fy = y in place. */
static void solve_factor(const airpuck_qp *qp, airpuck_real *y)
{
    for (int j = qp->active - 1; j >= 0; j--) {
        const airpuck_real *column = factor_column(qp, j);
        y[j] /= column[j];
        accumulate(j, -y[j], column, y);
    }
}

/* Improve the column of F for constraint i, and return the squared distance of its normal from the
 * others' span. The distance is computed from the residual of the projection, which is projected
 * again, so neither has suffered cancellation. `column` gets the coefficients of the projection. */
static airpuck_real project_again(airpuck_qp *qp, int i, airpuck_real *added)
{
    airpuck_real square = 0;
    memcpy(qp->column, added, (size_t)qp->active * sizeof *added);
    solve_factor(qp, qp->column);
    for (int pass = 0;; pass++) {
        memset(qp->residual, 0, (size_t)qp->n * sizeof *qp->residual);
        add_normal(qp, i, 1, qp->residual);
        for (int j = 0; j < qp->active; j++)
            add_normal(qp, qp->working[j], -qp->column[j], qp->residual);
        square = dot(qp->n, qp->residual, qp->residual) + compliance(qp, i);
        for (int j = 0; j < qp->active; j++)
            square += compliance(qp, qp->working[j]) * qp->column[j] * qp->column[j];
        if (pass == 1)
            return square;
        for (int j = 0; j < qp->active; j++)
            qp->target[j] = dot_normal(qp, qp->working[j], qp->residual) -
                            compliance(qp, qp->working[j]) * qp->column[j];
        solve_transposed(qp, qp->target);
        accumulate(qp->active, 1, qp->target, added);
        solve_factor(qp, qp->target);
        accumulate(qp->active, 1, qp->target, qp->column);
    }
}

/* Append constraint i with a multiplier to the active ones. Return 0 if its normal depends on
 * theirs; `column` then has the coefficients. */
static int append(airpuck_qp *qp, int i, airpuck_real multiplier)
{
    int first, other, count = qp->active;
    const airpuck_real *m = normal(qp, i, &first);
    airpuck_real *added = factor_column(qp, count);
    for (int j = 0; j < count; j++) {
        const airpuck_real *before = normal(qp, qp->working[j], &other);
        int from = other > first ? other : first;
        added[j] = dot(qp->n - from, m + from - first, before + from - other);
    }
    solve_transposed(qp, added);
    airpuck_real square = 1 + compliance(qp, i) - dot(count, added, added);
    if (square < CANCELLED || count >= qp->n + qp->soft)
        square = project_again(qp, i, added);
    /* The own dimension of a stiff row may be short. */
    airpuck_real own = is_beyond(qp, i) && compliance(qp, i) < 1 ? compliance(qp, i) : 1;
    if (!(square > DEPENDENT * own) || count >= qp->n + qp->soft)
        return 0;
    added[count] = AIRPUCK_F(sqrt)(square);
    qp->working[count] = i;
    qp->dual[count] = multiplier;
    qp->active++;
    return 1;
}

/* Remove the active constraint at a position; rotations restore the triangle. */
static void remove_active(airpuck_qp *qp, int position)
{
    int last = qp->active - 1;
    for (int i = position; i < last; i++) {
        airpuck_real *next = factor_column(qp, i + 1);
        airpuck_real length = AIRPUCK_F(sqrt)(next[i] * next[i] + next[i + 1] * next[i + 1]);
        airpuck_real cosine = next[i] / length, sine = next[i + 1] / length;
        for (int j = i + 1; j <= last; j++) {
            airpuck_real *column = factor_column(qp, j), above = column[i], below = column[i + 1];
            column[i] = cosine * above + sine * below;
            column[i + 1] = cosine * below - sine * above;
        }
        memcpy(factor_column(qp, i), next, (size_t)(i + 1) * sizeof *next);
        qp->working[i] = qp->working[i + 1];
        qp->dual[i] = qp->dual[i + 1];
    }
    qp->active = last;
}

/* ---- The method. Multipliers stay in their ranges and move towards those that solve the problem
 * with the active constraints as equations. */

/* Return how far the multiplier of constraint i can move along a direction, in units of it. */
static airpuck_real step_to_end(const airpuck_qp *qp, int i, airpuck_real value,
                                airpuck_real direction)
{
    airpuck_real s = sign(qp, i), size = s * value, rate = s * direction, w = threshold(qp, i);
    if (qp->state[i] == AIRPUCK_QP_EQUALITY || rate == 0)
        return INFINITY;
    if (rate < 0)
        return larger(size - (is_beyond(qp, i) ? w : 0), 0) / -rate;
    return is_beyond(qp, i) || !is_soft(qp, i) ? INFINITY : larger(w - size, 0) / rate;
}

/* Move along the direction in `target`, at most to `limit`. Return the position of the multiplier
 * that stops the move, or -1; set the distance. */
static int advance(airpuck_qp *qp, airpuck_real limit, airpuck_real *distance)
{
    int stopped = -1;
    airpuck_real fastest = 0;
    *distance = limit;
    for (int j = 0; j < qp->active; j++) {
        airpuck_real t = step_to_end(qp, qp->working[j], qp->dual[j], qp->target[j]);
        airpuck_real rate = AIRPUCK_F(fabs)(qp->target[j]);
        /* Of several that stop it at once, the fastest is the safest to take out. */
        if (t < *distance || (t == *distance && stopped >= 0 && rate > fastest)) {
            *distance = t;
            stopped = j;
            fastest = rate;
        }
    }
    if (*distance < INFINITY)
        accumulate(qp->active, *distance, qp->target, qp->dual);
    return stopped;
}

/* Change the state of a constraint whose multiplier crosses an end of its range in a direction;
 * return the multiplier at that end. */
static airpuck_real change_state(airpuck_qp *qp, int i, airpuck_real direction)
{
    airpuck_real s = sign(qp, i), w = threshold(qp, i);
    if (s * direction > 0)
        qp->state[i] = s > 0 ? AIRPUCK_QP_BEYOND_LOWER : AIRPUCK_QP_BEYOND_UPPER;
    else if (is_beyond(qp, i))
        qp->state[i] = s > 0 ? AIRPUCK_QP_AT_LOWER : AIRPUCK_QP_AT_UPPER;
    else
        qp->state[i] = AIRPUCK_QP_INACTIVE;
    return qp->state[i] == AIRPUCK_QP_INACTIVE ? 0 : s * w;
}

/* Leave out a constraint that depends on the active ones. */
static void skip_dependent(airpuck_qp *qp, int i)
{
    qp->state[i] =
        qp->state[i] == AIRPUCK_QP_EQUALITY ? AIRPUCK_QP_REDUNDANT : AIRPUCK_QP_INACTIVE;
}

/* Make constraint i active, with a multiplier that is going to move in a direction. As long as its
 * normal depends on the active ones, multipliers can move without changing u, until one of them
 * reaches the end of its range. Return whether that happens; otherwise the problem is infeasible,
 * or the iterations are spent. */
static int enter(airpuck_qp *qp, int i, airpuck_real value, airpuck_real direction)
{
    while (!append(qp, i, value)) {
        airpuck_real own = step_to_end(qp, i, value, direction), distance;
        for (int j = 0; j < qp->active; j++)
            qp->target[j] = -direction * qp->column[j];
        int stopped = advance(qp, own, &distance);
        if (!(distance < INFINITY) || ++qp->iterations > qp->iteration_limit)
            return 0;
        value += distance * direction;
        if (stopped < 0) {
            value = change_state(qp, i, direction);
            if (qp->state[i] == AIRPUCK_QP_INACTIVE)
                return 1;
            continue;
        }
        int other = qp->working[stopped];
        airpuck_real moved = qp->target[stopped], edge = change_state(qp, other, moved);
        remove_active(qp, stopped);
        if (qp->state[other] == AIRPUCK_QP_INACTIVE || append(qp, other, edge))
            continue;
        /* A soft row has come back to its limit, where its normal depends on the others'. */
        if (!append(qp, i, value))
            skip_dependent(qp, i);
        i = other;
        value = edge;
        direction = moved > 0 ? AIRPUCK_R(1.0) : AIRPUCK_R(-1.0);
    }
    return 1;
}

/* Right-hand side of the equation of an active constraint. */
static airpuck_real right_hand_side(const airpuck_qp *qp, int i)
{
    airpuck_real s = sign(qp, i), limit = s > 0 ? qp->lower[i] : qp->upper[i];
    return is_beyond(qp, i) ? limit + s * threshold(qp, i) * compliance(qp, i) : limit;
}

/* Start with the constraints that the caller marked as active; equalities come first. */
static void begin_active(airpuck_qp *qp)
{
    qp->active = 0;
    for (int equalities = 1; equalities >= 0; equalities--)
        for (int i = 0; i < qp->n + qp->rows; i++) {
            if (qp->state[i] == AIRPUCK_QP_INACTIVE ||
                (qp->state[i] == AIRPUCK_QP_EQUALITY) != equalities)
                continue;
            airpuck_real value = is_beyond(qp, i) ? sign(qp, i) * threshold(qp, i) : 0;
            if (!append(qp, i, value))
                skip_dependent(qp, i);
        }
}

/* Move the multipliers to those of the active constraints as equations, or until one reaches the
 * end of its range and changes its state. To refine multipliers, `target` has the errors of the
 * equations. Return whether they arrived. */
static int solve_active(airpuck_qp *qp, int refine)
{
    airpuck_real distance;
    for (int j = 0; j < qp->active && !refine; j++)
        qp->target[j] = right_hand_side(qp, qp->working[j]);
    solve_transposed(qp, qp->target);
    solve_factor(qp, qp->target);
    if (!refine)
        accumulate(qp->active, -1, qp->dual, qp->target);
    int stopped = advance(qp, 1, &distance);
    if (stopped < 0)
        return 1;
    int i = qp->working[stopped];
    airpuck_real moved = qp->target[stopped], value = change_state(qp, i, moved);
    remove_active(qp, stopped);
    /* This can fail only if the iterations are spent. */
    if (qp->state[i] != AIRPUCK_QP_INACTIVE)
        enter(qp, i, value, moved > 0 ? AIRPUCK_R(1.0) : AIRPUCK_R(-1.0));
    return 0;
}

/* Set u from the multipliers. Return the largest residual of the active constraints, relative to
 * `size`, and put the residuals into `target`. */
static airpuck_real set_point(airpuck_qp *qp, airpuck_real *size)
{
    airpuck_real largest = 0;
    memset(qp->x, 0, (size_t)qp->n * sizeof *qp->x);
    for (int j = 0; j < qp->active; j++)
        add_normal(qp, qp->working[j], qp->dual[j], qp->x);
    *size = AIRPUCK_F(sqrt)(dot(qp->n, qp->x, qp->x)) +
            AIRPUCK_F(sqrt)(dot(qp->n, qp->gradient, qp->gradient));
    for (int j = 0; j < qp->active; j++) {
        int i = qp->working[j];
        airpuck_real right = right_hand_side(qp, i);
        qp->target[j] = right - dot_normal(qp, i, qp->x) - compliance(qp, i) * qp->dual[j];
        if (qp->target[j] != 0)
            largest = larger(largest, AIRPUCK_F(fabs)(qp->target[j]) /
                                          (*size + AIRPUCK_F(fabs)(right)));
    }
    return largest;
}

/* Return the most violated constraint, or the first if iterations suggest a cycle; -1: none. Set
 * the direction in which its multiplier will move. */
static int violated(const airpuck_qp *qp, airpuck_real size, airpuck_real *direction)
{
    int worst = -1, cycling = qp->iterations > CYCLING * (qp->n + qp->rows);
    airpuck_real most = 0;
    for (int i = 0; i < qp->n + qp->rows && !(cycling && worst >= 0); i++) {
        int out = qp->state[i] == AIRPUCK_QP_INACTIVE || qp->state[i] == AIRPUCK_QP_REDUNDANT;
        if (!out || qp->scale[i] == 0)
            continue;
        airpuck_real value = dot_normal(qp, i, qp->x);
        airpuck_real below = qp->lower[i] - value, above = value - qp->upper[i];
        airpuck_real by = larger(below, above), limit = below > above ? qp->lower[i] : qp->upper[i];
        if (by > most && by > FEASIBLE * (size + AIRPUCK_F(fabs)(limit))) {
            most = by;
            worst = i;
            *direction = below > above ? AIRPUCK_R(1.0) : AIRPUCK_R(-1.0);
        }
    }
    return worst;
}

/* Transform u back to x; return what was found. */
static airpuck_qp_status finish(airpuck_qp *qp, airpuck_real error)
{
    int softened = 0;
    accumulate(qp->n, -1, qp->gradient, qp->x);
    for (int i = 0; i < qp->n; i++)
        qp->x[i] = dot_normal(qp, i, qp->x) / qp->scale[i];
    for (int j = 0; j < qp->active; j++)
        softened |= is_beyond(qp, qp->working[j]);
    if (!all_finite(qp->n, qp->x))
        return AIRPUCK_QP_NOT_FINITE;
    if (!(error <= INEXACT))
        return AIRPUCK_QP_INEXACT;
    return softened ? AIRPUCK_QP_SOFTENED : AIRPUCK_QP_SOLVED;
}

airpuck_qp_status airpuck_qp_solve(airpuck_qp *qp)
{
    int refined = 0;
    airpuck_real size, direction = 1;
    airpuck_qp_status status = transform(qp);
    if (status != AIRPUCK_QP_SOLVED)
        return status;
    begin_active(qp);
    while (qp->iterations++ < qp->iteration_limit) {
        if (!solve_active(qp, refined > 0)) {
            refined = 0;
            continue;
        }
        airpuck_real error = set_point(qp, &size);
        if (error > FEASIBLE && refined < REFINEMENTS) {
            refined++;
            continue;
        }
        refined = 0;
        if (!(size < INFINITY))
            return AIRPUCK_QP_NOT_FINITE;
        int i = violated(qp, size, &direction);
        if (i < 0)
            return finish(qp, error);
        if (qp->state[i] == AIRPUCK_QP_REDUNDANT)
            qp->state[i] = AIRPUCK_QP_EQUALITY;
        else
            qp->state[i] = direction > 0 ? AIRPUCK_QP_AT_LOWER : AIRPUCK_QP_AT_UPPER;
        if (!enter(qp, i, 0, direction)) {
            /* The next problem must not start from a constraint that is not active. */
            qp->state[i] = AIRPUCK_QP_INACTIVE;
            break;
        }
    }
    if (qp->iterations > qp->iteration_limit)
        return AIRPUCK_QP_ITERATION_LIMIT;
    return AIRPUCK_QP_INFEASIBLE;
}
