/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_laws.h"

#include <string.h>

#define N AIRPUCK_MOTORS
#define PI AIRPUCK_R(3.14159265358979323846)
#ifdef AIRPUCK_SINGLE
#define RESOLVED AIRPUCK_R(2e-7)
#else
/* Change of a motor speed at which the inverse of its thrust curve has converged. */
#define RESOLVED AIRPUCK_R(1e-12)
#endif
/* Newton's method needs about five iterations, bisection alone 40: this bound is never reached. */
#define MOST_PASSES 100

/* The quadratic program of the allocation; see airpuck_lqr. */
typedef struct {
    airpuck_real rows[3][AIRPUCK_ALLOCATED];
    airpuck_real wanted[3];
    airpuck_real lower[AIRPUCK_ALLOCATED], upper[AIRPUCK_ALLOCATED];
} allocation;

airpuck_real airpuck_wrapped(airpuck_real angle)
{
    /* A full turn in two parts, the first with few digits, so that a float holds its multiples. */
    airpuck_real turns = AIRPUCK_F(rint)(angle * (AIRPUCK_R(0.5) / PI));
    return angle - turns * AIRPUCK_R(6.28125) - turns * AIRPUCK_R(1.9353071795864769e-3);
}

airpuck_real airpuck_clipped(airpuck_real number, airpuck_real least, airpuck_real most)
{
    if (number < least)
        return least;
    return number > most ? most : number;
}

int airpuck_finite(const airpuck_real *numbers, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(numbers[i]))
            return 0;
    return 1;
}

void airpuck_acceleration_map(airpuck_real yaw, airpuck_real spin, airpuck_real matrix[3][N],
                              airpuck_real offset[3])
{
    const airpuck_model *model = &airpuck_identified;
    airpuck_real cosine = AIRPUCK_F(cos)(yaw), sine = AIRPUCK_F(sin)(yaw), rx, ry;
    airpuck_center_of_mass(model, cosine, sine, &rx, &ry);
    for (int i = 0; i < N; i++) {
        airpuck_real forward = model->configuration[0][i], left = model->configuration[1][i];
        airpuck_real angular = model->configuration[2][i];
        matrix[0][i] = cosine * forward - sine * left + ry * angular;
        matrix[1][i] = sine * forward + cosine * left - rx * angular;
        matrix[2][i] = angular;
    }
    offset[0] = rx * (spin * spin) + model->slope[0];
    offset[1] = ry * (spin * spin) + model->slope[1];
    offset[2] = 0;
}

/* The state one period later. Until then the motor speeds fix the accelerations. */
static void look_ahead(const airpuck *craft, airpuck_real following[6])
{
    airpuck_real matrix[3][N], offset[3], force[N], h = airpuck_tuned.period;
    airpuck_acceleration_map(craft->state[2], craft->state[5], matrix, offset);
    airpuck_thrust(&airpuck_identified, craft->motor_speed, force);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real settled = offset[axis] + craft->disturbance[axis];
        for (int i = 0; i < N; i++)
            settled += matrix[axis][i] * force[i];
        following[axis] = craft->state[axis] + h * craft->state[3 + axis] + h * h / 2 * settled;
        following[3 + axis] = craft->state[3 + axis] + h * settled;
    }
}

/* Request the acceleration a_ref - K (x - x_ref), without the disturbance. */
static void request(airpuck *craft, const airpuck_real following[6], const airpuck_target *target)
{
    airpuck_real error[6];
    for (int i = 0; i < 6; i++)
        error[i] = following[i] - target->state[i];
    error[2] = airpuck_wrapped(error[2]);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real fed_back = 0;
        for (int i = 0; i < 6; i++)
            fed_back += airpuck_tuned.gain[axis][i] * error[i];
        craft->request[axis] = target->acceleration[axis] - fed_back - craft->disturbance[axis];
    }
}

void airpuck_thrust_range(const airpuck *craft, airpuck_real coasting[N], airpuck_real least[N],
                          airpuck_real most[N])
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    for (int i = 0; i < N; i++) {
        coasting[i] = tuning->motor_lag * craft->motor_speed[i];
        least[i] = coasting[i] + tuning->motor_drive * tuning->command_min;
        most[i] = coasting[i] + tuning->motor_drive * tuning->command_max;
    }
    airpuck_thrust(&airpuck_identified, least, least);
    airpuck_thrust(&airpuck_identified, most, most);
}

/* Write the program: thrusts F and scaled slacks root (1 - s) that give the request,
 *
 *     min |F|^2 + root^2 (1 - s1)^2 + root^2 (1 - s2)^2
 *     such that (s1 vx, s1 vy, s2 v_yaw) = M F + g, lower <= F <= upper, 0 <= s1, s2 <= 1.
 *
 * The scale of the slacks makes the Hessian a multiple of the identity. Return whether all its
 * numbers are finite. */
static int pose_problem(const airpuck *craft, const airpuck_real following[6],
                        airpuck_real coasting[N], allocation *posed)
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_real matrix[3][N], offset[3];
    airpuck_acceleration_map(following[2], following[5], matrix, offset);
    airpuck_thrust_range(craft, coasting, posed->lower, posed->upper);
    for (int s = 0; s < 2; s++) {
        posed->lower[N + s] = 0;
        posed->upper[N + s] = tuning->slack_root;
    }
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real scale = axis == 2 ? tuning->arm : 1, asked = scale * craft->request[axis];
        for (int i = 0; i < N; i++)
            posed->rows[axis][i] = scale * matrix[axis][i];
        posed->rows[axis][N] = axis == 2 ? 0 : asked / tuning->slack_root;
        posed->rows[axis][N + 1] = axis == 2 ? asked / tuning->slack_root : 0;
        posed->wanted[axis] = asked - scale * offset[axis];
    }
    return airpuck_finite(posed->rows[0], 3 * AIRPUCK_ALLOCATED) &&
           airpuck_finite(posed->wanted, 3) && airpuck_finite(posed->lower, AIRPUCK_ALLOCATED) &&
           airpuck_finite(posed->upper, AIRPUCK_ALLOCATED);
}

/* Minimise x'x over n variables with rows * x = wanted and x within bounds; return whether that is
 * feasible. `sense` gets the active bounds. */
static int solve_least(airpuck *craft, int n, airpuck_real *rows, const airpuck_real wanted[3],
                       const airpuck_real *lower, const airpuck_real *upper, airpuck_real *x,
                       int sense[AIRPUCK_ALLOCATED + 3])
{
    airpuck_qp qp;
    airpuck_qp_begin(&qp, n, 3, 0, rows, craft->numbers, craft->active, sense);
#ifdef AIRPUCK_SINGLE
    qp.settings.primal_tol = AIRPUCK_R(2e-6);
#else
    /* With its default tolerances, DAQP calls small requests with nearly parallel columns
     * infeasible, and misses others slightly. */
    qp.settings.sing_tol = AIRPUCK_R(1e-14);
    qp.settings.primal_tol = AIRPUCK_R(1e-9);
#endif
    for (int i = 0; i < n + 3; i++) {
        int equality = i >= n;
        sense[i] = equality ? DAQP_ACTIVE | DAQP_IMMUTABLE : 0;
        qp.lower[i] = equality ? wanted[i - n] : lower[i];
        qp.upper[i] = equality ? wanted[i - n] : upper[i];
    }
    airpuck_qp_factor_twice_identity(&qp);
    int flag = airpuck_qp_solve(&qp);
    craft->iterations += qp.work.iterations;
    for (int i = 0; i < n; i++)
        x[i] = qp.work.x[i];
    return flag == DAQP_EXIT_OPTIMAL;
}

#ifndef AIRPUCK_SINGLE

/* Solve the program; return whether it is feasible. */
static int solve_constrained(airpuck *craft, allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    int sense[AIRPUCK_ALLOCATED + 3];
    return solve_least(craft, AIRPUCK_ALLOCATED, posed->rows[0], posed->wanted, posed->lower,
                       posed->upper, x, sense);
}

#else

/* A float cannot resolve the cost of thrusts beside that of slacks, a million times as large: DAQP
 * squares the condition of the program. In single precision it therefore only proposes the active
 * bounds, from easier programs: first without scaling the request, then with the least scaling,
 * where thrusts cost what they differ from those of the previous pass. `refine` then solves the
 * program itself by orthogonal transformations, which do not square the condition. */
#define PASSES 12
/* Thrusts, slacks and the residuals of the nearest acceleration. */
#define MOST (AIRPUCK_ALLOCATED + 3)
/* Relative errors within which a bound is met, and a multiplier has the right sign. */
#define MET AIRPUCK_R(1e-6)
#define SIGNED AIRPUCK_R(4e-6)

/* Minimise x'x such that sum of x_j column_j = wanted, and lower <= x <= upper. */
typedef struct {
    int n;
    airpuck_real columns[MOST][3], wanted[3], lower[MOST], upper[MOST];
} least_norm;

/* Reflect the vector `y` of `count` entries by `v`, from its entry k on. */
static void reflect(int count, int k, const airpuck_real v[MOST], airpuck_real y[MOST])
{
    airpuck_real square = 0, along = 0;
    for (int i = k; i < count; i++) {
        square += v[i] * v[i];
        along += v[i] * y[i];
    }
    for (int i = k; i < count; i++)
        y[i] -= 2 * along / square * v[i];
}

/* Set x and the multipliers of the equations with some variables at a bound (side -1 or 1); return
 * whether that is possible. The transposed columns of the free variables are factored by
 * Householder's reflections; sorted by size, as they are, they keep their relative precision. */
static int solve_sides(const least_norm *p, const int side[MOST], airpuck_real x[MOST],
                       airpuck_real price[3])
{
    airpuck_real m[3][MOST], v[3][MOST], r[3][3], rest[3], y[MOST] = {0};
    int free[MOST], count = 0, order[3] = {0, 1, 2};
    for (int axis = 0; axis < 3; axis++)
        rest[axis] = p->wanted[axis];
    for (int j = 0; j < p->n; j++) {
        x[j] = side[j] < 0 ? p->lower[j] : p->upper[j];
        for (int axis = 0; axis < 3; axis++) {
            m[axis][count] = p->columns[j][axis];
            rest[axis] -= side[j] != 0 ? p->columns[j][axis] * x[j] : 0;
        }
        if (side[j] == 0)
            free[count++] = j;
    }
    if (count < 3)
        return 0;
    for (int k = 0; k < 3; k++) {
        airpuck_real largest = 0;
        int chosen = k;
        for (int axis = k; axis < 3; axis++) {
            airpuck_real square = 0;
            for (int i = k; i < count; i++)
                square += m[order[axis]][i] * m[order[axis]][i];
            if (square > largest) {
                largest = square;
                chosen = axis;
            }
        }
        int taken = order[chosen];
        order[chosen] = order[k];
        order[k] = taken;
        airpuck_real length = AIRPUCK_F(sqrt)(largest);
        if (!(length > 0))
            return 0;
        for (int i = k; i < count; i++)
            v[k][i] = m[taken][i];
        v[k][k] += m[taken][k] < 0 ? -length : length;
        for (int axis = k; axis < 3; axis++)
            reflect(count, k, v[k], m[order[axis]]);
    }
    for (int before = 0; before < 3; before++)
        for (int k = before; k < 3; k++)
            r[before][k] = m[order[k]][before];
    for (int k = 0; k < 3; k++) {
        y[k] = rest[order[k]];
        for (int before = 0; before < k; before++)
            y[k] -= r[before][k] * y[before];
        y[k] /= r[k][k];
    }
    for (int k = 2; k >= 0; k--) {
        airpuck_real sum = y[k];
        for (int after = k + 1; after < 3; after++)
            sum -= r[k][after] * price[order[after]];
        price[order[k]] = sum / r[k][k];
    }
    for (int k = 2; k >= 0; k--)
        reflect(count, k, v[k], y);
    for (int i = 0; i < count; i++)
        x[free[i]] = y[i];
    return 1;
}

/* Solve a program from proposed active bounds; return whether a solution was found. */
static int refine(const least_norm *p, int side[MOST], airpuck_real x[MOST])
{
    airpuck_real price[3];
    for (int pass = 0; pass < 2 * MOST; pass++) {
        airpuck_real worst = 0;
        int changed = -1, to = 0;
        if (!solve_sides(p, side, x, price))
            return 0;
        for (int j = 0; j < p->n; j++) {
            airpuck_real range = p->upper[j] - p->lower[j];
            airpuck_real below = (p->lower[j] - x[j]) / range, above = (x[j] - p->upper[j]) / range;
            if (side[j] == 0 && below > MET && below > worst) {
                worst = below;
                changed = j;
                to = -1;
            }
            if (side[j] == 0 && above > MET && above > worst) {
                worst = above;
                changed = j;
                to = 1;
            }
        }
        for (int j = 0; j < p->n && changed < 0; j++) {
            airpuck_real pull = x[j], size = AIRPUCK_F(fabs)(x[j]);
            for (int axis = 0; axis < 3; axis++) {
                airpuck_real part = p->columns[j][axis] * price[axis];
                pull -= part;
                size += AIRPUCK_F(fabs)(part);
            }
            airpuck_real wrong = (airpuck_real)side[j] * pull / size;
            if (wrong > SIGNED && wrong > worst && p->upper[j] > p->lower[j]) {
                worst = wrong;
                changed = j;
                to = 0;
                break;
            }
        }
        if (changed < 0)
            return airpuck_finite(x, p->n);
        side[changed] = to;
    }
    return 0;
}

/* Write the sides of thrusts at their bounds; slacks are free. */
static void begin_sides(const int sense[N], int side[MOST])
{
    for (int j = 0; j < MOST; j++)
        side[j] = j < N && (sense[j] & DAQP_ACTIVE) ? sense[j] & DAQP_LOWER ? -1 : 1 : 0;
}

/* Refine a solution of the program, given the active bounds of its thrusts. */
static int refine_scaled(const allocation *posed, const int sense[N],
                         airpuck_real x[AIRPUCK_ALLOCATED])
{
    least_norm p = {.n = AIRPUCK_ALLOCATED};
    int side[MOST];
    airpuck_real found[MOST];
    begin_sides(sense, side);
    for (int j = 0; j < p.n; j++) {
        for (int axis = 0; axis < 3; axis++)
            p.columns[j][axis] = posed->rows[axis][j];
        p.lower[j] = posed->lower[j];
        p.upper[j] = posed->upper[j];
    }
    memcpy(p.wanted, posed->wanted, sizeof p.wanted);
    if (!refine(&p, side, found))
        return 0;
    for (int j = 0; j < p.n; j++)
        x[j] = airpuck_clipped(found[j], p.lower[j], p.upper[j]);
    return 1;
}

/* Refine the nearest acceleration: its residuals become variables, as expensive as they are in the
 * program. x is in the units of that program. */
static void refine_nearest(const airpuck_qp *qp, const airpuck_real a[3][AIRPUCK_ALLOCATED],
                           const airpuck_real wanted[3], const airpuck_real weights[2],
                           airpuck_real x[AIRPUCK_ALLOCATED])
{
    least_norm p = {.n = MOST};
    int side[MOST];
    airpuck_real found[MOST], unit = AIRPUCK_F(sqrt)(weights[1] / weights[0]);
    begin_sides(qp->work.sense, side);
    for (int j = 0; j < AIRPUCK_ALLOCATED; j++) {
        airpuck_real scale = j < N ? 1 : unit;
        for (int axis = 0; axis < 3; axis++)
            p.columns[j][axis] = a[axis][j] / scale;
        p.lower[j] = qp->lower[j] * scale;
        p.upper[j] = qp->upper[j] * scale;
    }
    for (int axis = 0; axis < 3; axis++) {
        int j = AIRPUCK_ALLOCATED + axis;
        p.columns[j][axis] = AIRPUCK_F(sqrt)(weights[0]);
        p.lower[j] = -INFINITY;
        p.upper[j] = INFINITY;
    }
    memcpy(p.wanted, wanted, sizeof p.wanted);
    if (!refine(&p, side, found))
        return;
    for (int j = 0; j < AIRPUCK_ALLOCATED; j++)
        x[j] = airpuck_clipped(found[j] / (j < N ? 1 : unit), qp->lower[j], qp->upper[j]);
}

/* Return the unit of thrust changes. In this unit, changes that are small compared with the request
 * cost as little as scaling it. */
static airpuck_real thrust_unit(const allocation *posed)
{
    airpuck_real column = 0, asked = 0;
    for (int i = 0; i < AIRPUCK_ALLOCATED; i++) {
        airpuck_real square = 0;
        for (int axis = 0; axis < 3; axis++)
            square += posed->rows[axis][i] * posed->rows[axis][i];
        if (i < N)
            column = square > column ? square : column;
        else
            asked = square > asked ? square : asked;
    }
    return 20 * airpuck_tuned.slack_root * AIRPUCK_F(sqrt)(asked / column);
}

static int solve_exact(airpuck *craft, const allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    airpuck_real rows[3][N];
    int sense[AIRPUCK_ALLOCATED + 3];
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < N; i++)
            rows[axis][i] = posed->rows[axis][i];
    x[N] = x[N + 1] = 0;
    if (!solve_least(craft, N, rows[0], posed->wanted, posed->lower, posed->upper, x, sense))
        return 0;
    refine_scaled(posed, sense, x);
    return 1;
}

static int solve_constrained(airpuck *craft, allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    if (solve_exact(craft, posed, x))
        return 1;
    airpuck_real force[N] = {0}, unit = thrust_unit(posed), root = airpuck_tuned.slack_root;
    for (int pass = 0; pass < PASSES; pass++) {
        airpuck_real rows[3][AIRPUCK_ALLOCATED], wanted[3];
        int sense[AIRPUCK_ALLOCATED + 3];
        airpuck_real lower[AIRPUCK_ALLOCATED], upper[AIRPUCK_ALLOCATED];
        for (int j = 0; j < AIRPUCK_ALLOCATED; j++) {
            lower[j] = j < N ? (posed->lower[j] - force[j]) / unit : 0;
            upper[j] = j < N ? (posed->upper[j] - force[j]) / unit : 1;
            for (int axis = 0; axis < 3; axis++)
                rows[axis][j] = posed->rows[axis][j] * (j < N ? unit : root);
        }
        for (int axis = 0; axis < 3; axis++) {
            wanted[axis] = posed->wanted[axis];
            for (int i = 0; i < N; i++)
                wanted[axis] -= posed->rows[axis][i] * force[i];
        }
        if (!solve_least(craft, AIRPUCK_ALLOCATED, rows[0], wanted, lower, upper, x, sense))
            return pass > 0 && airpuck_finite(x, AIRPUCK_ALLOCATED);
        for (int i = 0; i < N; i++)
            x[i] = force[i] =
                airpuck_clipped(force[i] + unit * x[i], posed->lower[i], posed->upper[i]);
        for (int slack = N; slack < AIRPUCK_ALLOCATED; slack++)
            x[slack] *= root;
        if (refine_scaled(posed, sense, x))
            return 1;
    }
    return 1;
}

#endif

/* Find the acceleration nearest to a scaled request: min |Ax - b|^2 + (small weights) x^2 over
 * thrusts and slacks 1 - s within their bounds. Return whether it was found. */
static int solve_nearest(airpuck *craft, const allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    const airpuck_real small[2] = {airpuck_tuned.tie_thrust, airpuck_tuned.tie_slack};
#ifdef AIRPUCK_SINGLE
    /* A float cannot resolve the small weights next to A'A; larger ones propose active bounds. */
    const airpuck_real weights[2] = {AIRPUCK_R(1e-3), AIRPUCK_R(1e-2)};
#else
    const airpuck_real *weights = small;
#endif
    int n = AIRPUCK_ALLOCATED, sense[AIRPUCK_ALLOCATED] = {0};
    airpuck_qp qp;
    airpuck_real a[3][AIRPUCK_ALLOCATED];
    airpuck_qp_begin(&qp, n, 0, 0, NULL, craft->numbers, craft->active, sense);
    for (int j = 0; j < n; j++) {
        airpuck_real unit = j < N ? 1 : airpuck_tuned.slack_root;
        qp.lower[j] = posed->lower[j] / unit;
        qp.upper[j] = posed->upper[j] / unit;
        qp.gradient[j] = 0;
        for (int axis = 0; axis < 3; axis++) {
            a[axis][j] = posed->rows[axis][j] * unit;
            qp.gradient[j] -= posed->wanted[axis] * a[axis][j];
        }
    }
    for (int i = 0, at = 0; i < n; i++)
        for (int j = i; j < n; j++, at++) {
            qp.hessian[at] = i == j ? weights[j >= N] : 0;
            for (int axis = 0; axis < 3; axis++)
                qp.hessian[at] += a[axis][i] * a[axis][j];
        }
    if (!airpuck_qp_factor(&qp))
        return 0;
    if (!airpuck_qp_unconstrained(&qp)) {
        int flag = airpuck_qp_solve(&qp);
        craft->iterations += qp.work.iterations;
        if (flag != DAQP_EXIT_OPTIMAL)
            return 0;
    }
    for (int i = 0; i < n; i++)
        x[i] = qp.work.x[i];
#ifdef AIRPUCK_SINGLE
    refine_nearest(&qp, (const airpuck_real(*)[AIRPUCK_ALLOCATED])a, posed->wanted, small, x);
#endif
    for (int s = N; s < n; s++)
        x[s] *= airpuck_tuned.slack_root;
    return 1;
}

static airpuck_status allocate(airpuck *craft, allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    if (!solve_constrained(craft, posed, x)) {
        int found = solve_nearest(craft, posed, x) && airpuck_finite(x, AIRPUCK_ALLOCATED);
        return found ? AIRPUCK_NEAREST : AIRPUCK_FAILED;
    }
    if (!airpuck_finite(x, AIRPUCK_ALLOCATED))
        return AIRPUCK_FAILED;
    airpuck_real slack = (x[N] > x[N + 1] ? x[N] : x[N + 1]) / airpuck_tuned.slack_root;
    return 1 - slack > 1 - airpuck_tuned.unscaled ? AIRPUCK_EXACT : AIRPUCK_SCALED;
}

/* Return the thrust of one motor; set the slope of its curve. */
static airpuck_real curve(int motor, airpuck_real speed, airpuck_real *slope)
{
    const airpuck_real *coefficients = airpuck_identified.thrust[motor];
    airpuck_real total = 0;
    *slope = 0;
    for (int power = AIRPUCK_DEGREE - 1; power >= 0; power--) {
        total = (total + coefficients[power]) * speed;
        *slope = *slope * speed + (airpuck_real)(power + 1) * coefficients[power];
    }
    return total;
}

/* Return the motor speed that gives a thrust, by Newton's method with bisection as safeguard. */
static airpuck_real inverse_thrust(int motor, airpuck_real force)
{
    airpuck_real slope, top = curve(motor, 1, &slope);
    airpuck_real target = airpuck_clipped(force, 0, top), low = 0, high = 1;
    airpuck_real speed = top > 0 ? target / top : 0;
    for (int pass = 0; pass < MOST_PASSES; pass++) {
        airpuck_real error = curve(motor, speed, &slope) - target;
        if (error <= 0)
            low = speed;
        if (error >= 0)
            high = speed;
        if (error == 0)
            break;
        airpuck_real newton = speed - error / slope;
        airpuck_real following = newton > low && newton < high ? newton : (low + high) / 2;
        airpuck_real change = AIRPUCK_F(fabs)(following - speed);
        speed = following;
        if (!(change > RESOLVED))
            break;
    }
    return speed;
}

airpuck_real airpuck_driven(int motor, airpuck_real force, airpuck_real coasting)
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_real driven = (inverse_thrust(motor, force) - coasting) / tuning->motor_drive;
    return airpuck_clipped(driven, tuning->command_min, tuning->command_max);
}

airpuck_status airpuck_lqr(airpuck *craft, const airpuck_target *target,
                           airpuck_real command[AIRPUCK_MOTORS])
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_real following[6], coasting[N], x[AIRPUCK_ALLOCATED];
    allocation posed;
    look_ahead(craft, following);
    request(craft, following, target);
    airpuck_status status = AIRPUCK_FAILED;
    if (pose_problem(craft, following, coasting, &posed))
        status = allocate(craft, &posed, x);
    if (status != AIRPUCK_FAILED) {
        for (int i = 0; i < N; i++) {
            /* The solver meets bounds to its tolerance; the result meets them exactly. */
            airpuck_real force = airpuck_clipped(x[i], posed.lower[i], posed.upper[i]);
            command[i] = airpuck_driven(i, force, coasting[i]);
        }
        if (airpuck_finite(command, N))
            return status;
    }
    for (int i = 0; i < N; i++)
        command[i] = tuning->command_min;
    return AIRPUCK_FAILED;
}
