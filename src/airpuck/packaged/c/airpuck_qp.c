/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_qp.h"

#include <float.h>
#include <string.h>

/* The steps of daqp_update_ldp (DAQP 0.11, utils.c; copyright (c) 2022 Daniel Arnstrom, MIT
 * licence in daqp/LICENSE) that form a least-distance problem
 * from a quadratic program with a positive definite Hessian, in the same order of operations:
 * H = R'R, M = A inv(R) with rows of unit length, v = inv(R)'f, d = b + M v. */

#ifdef AIRPUCK_SINGLE
#define ROUNDING FLT_EPSILON
#define SMALLEST_PIVOT AIRPUCK_R(1e-7)
#else
#define ROUNDING DBL_EPSILON
#define SMALLEST_PIVOT AIRPUCK_R(1e-11)
#endif
/* Condition of H from which DAQP refines a solution. */
#define REFINED AIRPUCK_R(1e6)

static airpuck_real *taken(airpuck_real **memory, int count)
{
    airpuck_real *array = *memory;
    *memory += count;
    return array;
}

static void default_settings(DAQPSettings *settings)
{
    memset(settings, 0, sizeof *settings);
    settings->iter_limit = DAQP_DEFAULT_ITER_LIMIT;
    settings->cycle_tol = DAQP_DEFAULT_CYCLE_TOL;
    settings->fval_bound = DAQP_INF;
    settings->eps_prox = AIRPUCK_R(-1e-6);
    settings->eta_prox = -1;
    settings->rho_soft = AIRPUCK_R(1e-6);
#ifdef AIRPUCK_SINGLE
    /* DAQP's tolerances lie below the rounding of a float. */
    settings->primal_tol = 2e-5f;
    settings->dual_tol = 1e-6f;
    settings->zero_tol = 1e-7f;
    settings->pivot_tol = 1e-4f;
    settings->progress_tol = 1e-6f;
    settings->sing_tol = 1e-6f;
    settings->refactor_tol = 1e-5f;
#else
    settings->primal_tol = DAQP_DEFAULT_PRIM_TOL;
    settings->dual_tol = DAQP_DEFAULT_DUAL_TOL;
    settings->zero_tol = DAQP_DEFAULT_ZERO_TOL;
    settings->pivot_tol = DAQP_DEFAULT_PIVOT_TOL;
    settings->progress_tol = DAQP_DEFAULT_PROG_TOL;
    settings->sing_tol = DAQP_DEFAULT_SING_TOL;
    settings->refactor_tol = DAQP_DEFAULT_REFACTOR_TOL;
#endif
}

void airpuck_qp_begin(airpuck_qp *qp, int n, int r, int s, airpuck_real *rows,
                      airpuck_real *numbers, int *active, int *sense)
{
    DAQPWorkspace *work = &qp->work;
    int m = n + r, k = AIRPUCK_QP_ACTIVE(n, s);
    memset(qp, 0, sizeof *qp);
    default_settings(&qp->settings);
    qp->hessian = taken(&numbers, n * (n + 1) / 2);
    work->M = taken(&numbers, r * n);
    qp->lower = taken(&numbers, m);
    qp->upper = taken(&numbers, m);
    work->dlower = taken(&numbers, m);
    work->dupper = taken(&numbers, m);
    work->scaling = taken(&numbers, m);
    qp->gradient = taken(&numbers, n);
    work->v = taken(&numbers, n);
    work->x = work->u = taken(&numbers, n);
    work->Mu = taken(&numbers, r);
    work->lam = taken(&numbers, k);
    work->lam_star = taken(&numbers, k);
    work->D = taken(&numbers, k);
    work->xldl = taken(&numbers, k);
    work->zldl = taken(&numbers, k);
    work->L = qp->scratch = taken(&numbers, k * (k + 1) / 2);
    work->WS = active;
    work->sense = sense;
    work->settings = &qp->settings;
    work->qp = &qp->problem;
    work->n = qp->problem.n = n;
    work->m = qp->problem.m = m;
    work->ms = qp->problem.ms = n;
    qp->problem.A = rows != NULL ? rows : work->M;
    qp->problem.blower = qp->lower;
    qp->problem.bupper = qp->upper;
    qp->problem.f = qp->gradient;
    qp->problem.sense = sense;
    work->outer_iter = 1;
    reset_daqp_workspace(work);
}

void airpuck_qp_factor_twice_identity(airpuck_qp *qp)
{
    DAQPWorkspace *work = &qp->work;
    airpuck_real root = AIRPUCK_F(sqrt)(AIRPUCK_R(2.0));
    work->RinvD = qp->hessian;
    for (int i = 0; i < work->n; i++) {
        work->RinvD[i] = 1 / root;
        work->scaling[i] = root;
        work->v[i] = 0;
    }
}

int airpuck_qp_factor(airpuck_qp *qp)
{
    DAQPWorkspace *work = &qp->work;
    int n = work->n;
    airpuck_real *factor = qp->hessian;
    airpuck_real largest = 0;
    for (int i = 0, at = 0; i < n; at += n - i, i++)
        largest = factor[at] > largest ? factor[at] : largest;
    /* Cholesky's factor, with reciprocals on the diagonal. */
    for (int i = 0; i < n; i++) {
        airpuck_real *row = factor + DAQP_R_OFFSET(i, n);
        if (!(row[i] > SMALLEST_PIVOT))
            return 0;
        airpuck_real reciprocal = 1 / AIRPUCK_F(sqrt)(row[i]);
        for (int j = i + 1; j < n; j++)
            row[j] *= reciprocal;
        for (int k = i + 1; k < n; k++) {
            airpuck_real *later = factor + DAQP_R_OFFSET(k, n), entry = row[k];
            for (int j = k; j < n; j++)
                later[j] -= entry * row[j];
        }
        row[i] = reciprocal;
    }
    work->Rinv = factor;
    /* Used again by airpuck_qp_solve. */
    work->fval = largest;
    return 1;
}

int airpuck_qp_unconstrained(airpuck_qp *qp)
{
    DAQPWorkspace *work = &qp->work;
    int n = work->n, met = 1;
    const airpuck_real *factor = work->Rinv;
    airpuck_real *v = work->v, *x = work->x;
    for (int i = 0; i < n; i++)
        v[i] = qp->gradient[i];
    for (int i = 0, at = 0; i < n; i++) {
        v[i] *= factor[at++];
        for (int j = i + 1; j < n; j++)
            v[j] -= factor[at++] * v[i];
    }
    for (int i = n - 1, at = n * (n + 1) / 2; i >= 0; i--) {
        airpuck_real sum = -v[i];
        at -= n - i;
        for (int j = i + 1; j < n; j++)
            sum -= factor[at + j - i] * x[j];
        x[i] = sum * factor[at];
        if (!(qp->upper[i] - x[i] >= -qp->settings.primal_tol &&
              qp->lower[i] - x[i] <= qp->settings.primal_tol))
            met = 0;
    }
    return met;
}

static void invert_factor(airpuck_real *factor, int n)
{
    for (int k = 0, at = 0; k < n; k++) {
        int other = at + 1;
        for (int j = k + 1; j < n; j++)
            factor[other++] *= -factor[at];
        at++;
        for (int i = k + 1; i < n; i++, at++) {
            factor[at] *= factor[other++];
            for (int j = 1; j < n - i; j++)
                factor[at + j] -= factor[other++] * factor[at];
        }
    }
}

/* Return whether a row of zeros contradicts its bounds. */
static int zero_row_infeasible(const airpuck_qp *qp, int i)
{
    int sense = DAQP_ZERO_ROW_SENSE(qp->work.sense[i]);
    airpuck_real upper = qp->upper[i], lower = qp->lower[i];
    if (upper - lower < -qp->settings.primal_tol && !(sense & DAQP_IMMUTABLE))
        return 1;
    return (upper < -qp->settings.zero_tol || lower > qp->settings.zero_tol) &&
           (sense & (DAQP_IMMUTABLE | DAQP_ACTIVE)) != DAQP_IMMUTABLE && !(sense & DAQP_SOFT);
}

/* Check the bounds, and mark equal ones as equalities; return whether they are consistent. */
static int check_bounds(airpuck_qp *qp)
{
    int *sense = qp->work.sense;
    for (int i = 0; i < qp->work.m; i++) {
        if ((sense[i] & DAQP_IMMUTABLE) && !(sense[i] & DAQP_AUTO_EQUALITY))
            continue;
        airpuck_real between = qp->upper[i] - qp->lower[i];
        if (between < -qp->settings.primal_tol)
            return 0;
        if (between < qp->settings.zero_tol && !(sense[i] & DAQP_SOFT))
            sense[i] |= DAQP_ACTIVE | DAQP_IMMUTABLE | DAQP_AUTO_EQUALITY;
        else if (sense[i] & DAQP_AUTO_EQUALITY)
            sense[i] &= ~(DAQP_ACTIVE | DAQP_IMMUTABLE | DAQP_AUTO_EQUALITY);
    }
    return 1;
}

/* M = A inv(R), in place if they are the same array, with rows of unit length. */
static int form_rows(airpuck_qp *qp)
{
    DAQPWorkspace *work = &qp->work;
    int n = work->n;
    for (int i = n; i < work->m; i++) {
        const airpuck_real *row = qp->problem.A + (i - n) * n;
        airpuck_real *m = work->M + (i - n) * n, square = 0;
        for (int k = n - 1; k >= 0; k--) {
            airpuck_real entry = row[k];
            if (work->Rinv == NULL) {
                m[k] = entry * work->RinvD[k];
                continue;
            }
            const airpuck_real *inverse = work->Rinv + DAQP_R_OFFSET(k, n);
            m[k] = entry * inverse[k];
            /* Early steps do not depend on late commands. */
            for (int j = k + 1; j < n && entry != 0; j++)
                m[j] += entry * inverse[j];
        }
        for (int j = 0; j < n; j++)
            square += m[j] * m[j];
        if (square < qp->settings.zero_tol) {
            /* The row constrains nothing: leave it out until it is no longer zero. */
            work->scaling[i] = 1;
            if (zero_row_infeasible(qp, i))
                return 0;
            int sense = DAQP_ZERO_ROW_SENSE(work->sense[i]);
            if (sense & DAQP_AUTO_EQUALITY)
                sense &= ~(DAQP_ACTIVE | DAQP_IMMUTABLE);
            work->sense[i] = DAQP_ZERO_ROW_MARK(sense);
            continue;
        }
        work->scaling[i] = 1 / AIRPUCK_F(sqrt)(square);
        for (int j = 0; j < n; j++)
            m[j] *= work->scaling[i];
    }
    return 1;
}

/* Scale the rows of inv(R) that are bounds of variables to unit length. */
static void scale_bounds(DAQPWorkspace *work)
{
    for (int i = 0, at = 0; i < work->n; at += work->n - i, i++) {
        airpuck_real square = 0;
        for (int j = 0; j < work->n - i; j++)
            square += work->Rinv[at + j] * work->Rinv[at + j];
        work->scaling[i] = 1 / AIRPUCK_F(sqrt)(square);
        for (int j = 0; j < work->n - i; j++)
            work->Rinv[at + j] *= work->scaling[i];
    }
}

static void form_bounds(airpuck_qp *qp)
{
    DAQPWorkspace *work = &qp->work;
    int n = work->n;
    for (int i = 0, at = 0; i < work->m; i++) {
        airpuck_real sum = 0;
        if (i >= n)
            for (int j = 0; j < n; j++)
                sum += work->M[(i - n) * n + j] * work->v[j];
        else if (work->Rinv != NULL)
            for (int j = i; j < n; j++)
                sum += work->Rinv[at++] * work->v[j];
        work->dupper[i] = qp->upper[i] * work->scaling[i] + sum;
        work->dlower[i] = qp->lower[i] * work->scaling[i] + sum;
    }
}

static int violates_hard(const airpuck_qp *qp)
{
    const DAQPWorkspace *work = &qp->work;
    int n = work->n;
    for (int i = 0; i < work->m; i++) {
        int sense = work->sense[i];
        if ((sense & DAQP_SOFT) || ((sense & DAQP_IMMUTABLE) && !(sense & DAQP_ACTIVE)))
            continue;
        airpuck_real value = i < n ? work->x[i] : 0;
        if (i >= n)
            for (int j = 0; j < n; j++)
                value += qp->problem.A[(i - n) * n + j] * work->x[j];
        if (value > qp->upper[i] + qp->settings.primal_tol ||
            value < qp->lower[i] - qp->settings.primal_tol)
            return 1;
    }
    return 0;
}

int airpuck_qp_solve(airpuck_qp *qp)
{
    DAQPWorkspace *work = &qp->work;
    int n = work->n;
    for (int i = n; i < work->m; i++)
        work->sense[i] = DAQP_ZERO_ROW_SENSE(work->sense[i]);
    if (!check_bounds(qp))
        return DAQP_EXIT_INFEASIBLE;
    if (work->Rinv != NULL) {
        invert_factor(work->Rinv, n);
        airpuck_real largest = 0;
        for (int i = 0, at = 0; i < n; i++) {
            airpuck_real square = 0;
            for (int j = i; j < n; j++, at++)
                square += work->Rinv[at] * work->Rinv[at];
            largest = square > largest ? square : largest;
        }
        if (largest * work->fval > REFINED)
            work->state |= DAQP_STATE_ILL_CONDITIONED;
        for (int j = 0; j < n; j++) {
            work->v[j] = 0;
            for (int i = 0; i <= j; i++)
                work->v[j] += work->Rinv[DAQP_R_OFFSET(i, n) + j] * qp->gradient[i];
        }
    }
    if (!form_rows(qp))
        return DAQP_EXIT_INFEASIBLE;
    if (work->Rinv != NULL)
        scale_bounds(work);
    work->state |= DAQP_STATE_RINV_NORMALIZED;
    form_bounds(qp);
    for (int i = 0; i < n; i++)
        work->u[i] = 0;
    int flag = daqp_reactivate_constraints(work);
    if (flag < 0)
        return flag;
    flag = daqp_ldp(work);
    if (flag > 0) {
        ldp2qp_solution(work);
        daqp_refine_primal(work);
        if ((work->state & DAQP_STATE_NOISE_FLOOR) && violates_hard(qp))
            return DAQP_EXIT_OPTIMAL_INEXACT;
    }
    return flag;
}
