/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_laws.h"
#include "airpuck_least_norm.h"

#include <string.h>

enum { MOTORS = AIRPUCK_MOTORS };
#ifdef AIRPUCK_SINGLE
#define RESOLVED AIRPUCK_R(2e-7)
#else
/* Change of a motor speed at which the inverse of its thrust curve has converged. */
#define RESOLVED AIRPUCK_R(1e-12)
#endif
/* Newton's method needs about five iterations, bisection alone 40: this bound is never reached. */
#define MOST_PASSES 100

airpuck_real airpuck_wrapped(airpuck_real angle)
{
    /* A full turn in two parts, the first with few digits, so that a float holds its multiples. */
    airpuck_real turns = AIRPUCK_F(rint)(angle * AIRPUCK_R(0.15915494309189534));
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

void airpuck_acceleration_map(airpuck_real yaw, airpuck_real spin, airpuck_real matrix[3][MOTORS],
                              airpuck_real offset[3])
{
    const airpuck_model *model = &airpuck_identified;
    airpuck_real cosine = AIRPUCK_F(cos)(yaw), sine = AIRPUCK_F(sin)(yaw), rx, ry;
    airpuck_center_of_mass(model, cosine, sine, &rx, &ry);
    for (int i = 0; i < MOTORS; i++) {
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
    airpuck_real matrix[3][MOTORS], offset[3], force[MOTORS], h = airpuck_tuned.period;
    airpuck_acceleration_map(craft->state[2], craft->state[5], matrix, offset);
    airpuck_thrust(&airpuck_identified, craft->motor_speed, force);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real settled = offset[axis] + craft->disturbance[axis];
        for (int i = 0; i < MOTORS; i++)
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

void airpuck_thrust_range(const airpuck *craft, airpuck_real coasting[MOTORS],
                          airpuck_real least[MOTORS],
                          airpuck_real most[MOTORS])
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    for (int i = 0; i < MOTORS; i++) {
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
 * The scale of the slacks makes it a problem of least norm. Return whether all its numbers are
 * finite. */
static int pose_problem(const airpuck *craft, const airpuck_real following[6],
                        airpuck_real coasting[MOTORS], airpuck_least_norm *posed)
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_real matrix[3][MOTORS], offset[3], least[MOTORS], most[MOTORS];
    int finite = 1;
    airpuck_acceleration_map(following[2], following[5], matrix, offset);
    airpuck_thrust_range(craft, coasting, least, most);
    posed->n = MOTORS + 2;
    posed->iterations = 0;
    for (int i = 0; i < MOTORS; i++) {
        posed->lower[i] = (double)least[i];
        posed->upper[i] = (double)most[i];
        finite &= isfinite(least[i]) && isfinite(most[i]);
    }
    for (int s = MOTORS; s < posed->n; s++) {
        posed->lower[s] = 0;
        posed->upper[s] = (double)tuning->slack_root;
    }
    for (int axis = 0; axis < 3; axis++) {
        double scale = axis == 2 ? (double)tuning->arm : 1;
        double asked = scale * (double)craft->request[axis], root = (double)tuning->slack_root;
        for (int i = 0; i < MOTORS; i++)
            posed->columns[i][axis] = scale * (double)matrix[axis][i];
        posed->columns[MOTORS][axis] = axis == 2 ? 0 : asked / root;
        posed->columns[MOTORS + 1][axis] = axis == 2 ? asked / root : 0;
        posed->wanted[axis] = asked - scale * (double)offset[axis];
        finite &= airpuck_finite(matrix[axis], MOTORS) && isfinite(posed->wanted[axis]);
    }
    return finite;
}

/* Find the acceleration nearest to a scaled request: min |r|^2 + (small weights) x^2 with the
 * residual r = b - A x of the equations, over thrusts and slacks 1 - s within their bounds. Their
 * weights become scales of the variables, so this is a problem of least norm again. Return whether
 * it was solved; `posed` then has its solution. */
static int solve_nearest(airpuck_least_norm *posed)
{
    airpuck_least_norm nearest = *posed;
    double units[MOTORS + 2];
    for (int j = 0; j < MOTORS + 2; j++) {
        int slack = j >= MOTORS;
        units[j] = slack ? (double)airpuck_tuned.slack_root / sqrt((double)airpuck_tuned.tie_slack)
                         : 1 / sqrt((double)airpuck_tuned.tie_thrust);
        nearest.lower[j] /= units[j];
        nearest.upper[j] /= units[j];
        for (int axis = 0; axis < 3; axis++)
            nearest.columns[j][axis] *= units[j];
    }
    nearest.n = MOTORS + 5;
    memset(nearest.side, AIRPUCK_LEAST_FREE, sizeof nearest.side);
    for (int axis = 0; axis < 3; axis++) {
        double *column = nearest.columns[MOTORS + 2 + axis];
        column[0] = column[1] = column[2] = 0;
        column[axis] = 1;
        nearest.lower[MOTORS + 2 + axis] = -INFINITY;
        nearest.upper[MOTORS + 2 + axis] = INFINITY;
    }
    int solved = airpuck_least_norm_solve(&nearest) == AIRPUCK_LEAST_SOLVED;
    for (int j = 0; j < MOTORS + 2; j++)
        posed->x[j] = nearest.x[j] * units[j];
    posed->iterations += nearest.iterations;
    return solved;
}

static airpuck_status allocate(airpuck_least_norm *posed)
{
    const double *x = posed->x;
    if (airpuck_least_norm_solve(posed) != AIRPUCK_LEAST_SOLVED)
        return solve_nearest(posed) ? AIRPUCK_NEAREST : AIRPUCK_FAILED;
    double reduced = (x[MOTORS] > x[MOTORS + 1] ? x[MOTORS] : x[MOTORS + 1]) /
                     (double)airpuck_tuned.slack_root;
    return reduced < (double)airpuck_tuned.unscaled ? AIRPUCK_EXACT : AIRPUCK_SCALED;
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
    airpuck_real following[6], coasting[MOTORS];
    airpuck_least_norm posed;
    look_ahead(craft, following);
    request(craft, following, target);
    airpuck_status status = AIRPUCK_FAILED;
    memcpy(posed.side, craft->sides, sizeof craft->sides);
    if (pose_problem(craft, following, coasting, &posed))
        status = allocate(&posed);
    memcpy(craft->sides, posed.side, sizeof craft->sides);
    craft->iterations += posed.iterations;
    if (status != AIRPUCK_FAILED) {
        for (int i = 0; i < MOTORS; i++) {
            /* The solver meets bounds to its tolerance; the result meets them exactly. */
            airpuck_real force =
                airpuck_clipped((airpuck_real)posed.x[i], (airpuck_real)posed.lower[i],
                                (airpuck_real)posed.upper[i]);
            command[i] = airpuck_driven(i, force, coasting[i]);
        }
        if (airpuck_finite(command, MOTORS))
            return status;
    }
    for (int i = 0; i < MOTORS; i++)
        command[i] = tuning->command_min;
    return AIRPUCK_FAILED;
}
