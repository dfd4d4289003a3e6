/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_laws.h"
#include "airpuck_slopes.h"

#include <string.h>

#if AIRPUCK_INTERVALS > 0

enum { MOTORS = AIRPUCK_MOTORS, STATES = AIRPUCK_STATES };
#ifdef AIRPUCK_SINGLE
/* Limits of a float: remaining slope, relative rounding of the function that is minimised, rounding
 * of a number of periods. */
#define TOLERANCE AIRPUCK_R(1e-4)
#define ROUNDED AIRPUCK_R(1e-6)
#define ROUNDING 1e-6
#else
#define TOLERANCE plan->tolerance
#define ROUNDED 0
#define ROUNDING plan->rounding
#endif

static const airpuck_flight *const plan = &airpuck_planned;

static double within(double number, double least, double most)
{
    return number < least ? least : number > most ? most : number;
}

/* Return the interval of a time. */
static int interval_at(double time)
{
    int first = 0, last = AIRPUCK_INTERVALS - 1;
    while (first < last) {
        int middle = (first + last + 1) / 2;
        if (plan->times[middle] <= time)
            first = middle;
        else
            last = middle - 1;
    }
    return first;
}

/* Set the planned state at a time; before the beginning and after the end the craft waits. */
static void state_at(double time, airpuck_real state[STATES])
{
    double inside = within(time, 0, plan->duration);
    int node = interval_at(inside);
    airpuck_real lasting = (airpuck_real)(plan->times[node + 1] - plan->times[node]);
    airpuck_real past = (airpuck_real)(inside - plan->times[node]) / lasting * AIRPUCK_PARTS;
    int part = past < AIRPUCK_PARTS ? (int)past : AIRPUCK_PARTS - 1;
    const airpuck_real *before = plan->states[node * AIRPUCK_PARTS + part];
    const airpuck_real *after = before + STATES;
    for (int i = 0; i < STATES; i++)
        state[i] = before[i] + (past - (airpuck_real)part) * (after[i] - before[i]);
}

void airpuck_flight_target(double time, airpuck_target *target)
{
    airpuck_real state[STATES];
    state_at(time, state);
    memset(target, 0, sizeof *target);
    memcpy(target->state, state, 3 * sizeof *state);
    if (!(0 <= time && time <= plan->duration))
        return;
    memcpy(target->state, state, 6 * sizeof *state);
    airpuck_acceleration(&airpuck_identified, state + 2, state + 6, target->acceleration);
}

#if AIRPUCK_STEPS == 0

/* The problem min |A x + missed|^2 + |x|^2 with bounds, in the caller's memory. */
typedef struct {
    int count;
    airpuck_real (*columns)[6], *low, *high;
    airpuck_real missed[6];
} corrections;

/* Set the state to track; after the end the craft rests and its motors spin down. */
static void tracked_at(double time, airpuck_real state[STATES])
{
    state_at(time, state);
    airpuck_real late = (airpuck_real)(time - plan->duration), idle = airpuck_tuned.command_min;
    airpuck_real lag = airpuck_identified.motor_time_constant;
    airpuck_real left = late > 0 ? AIRPUCK_F(exp)(-late / lag) : 1;
    for (int i = 6; i < STATES; i++)
        state[i] = idle + left * (state[i] - idle);
    for (int i = 3; i < 6 && late > 0; i++)
        state[i] = 0;
}

/* Set the mean thrusts that are asked of the motors over a period. */
static void asked_over(double begin, airpuck_real asked[MOTORS])
{
    memset(asked, 0, sizeof(airpuck_real) * MOTORS);
    for (int k = 0; k < plan->samples; k++) {
        double time = begin + (double)airpuck_tuned.period * (k + 0.5) / plan->samples;
        airpuck_real command[MOTORS], force[MOTORS];
        int flying = time >= 0 && time < plan->duration;
        for (int i = 0; i < MOTORS; i++)
            command[i] =
                flying ? plan->commands[interval_at(time)][i] : airpuck_tuned.command_min;
        airpuck_thrust(&airpuck_identified, command, force);
        for (int i = 0; i < MOTORS; i++)
            asked[i] += force[i] / (airpuck_real)plan->samples;
    }
}

/* Set the derivatives of the accelerations with respect to yaw, vx, vy and yaw rate. */
static void accelerations_change(const airpuck_real state[STATES], airpuck_real slopes[3][4])
{
#ifdef AIRPUCK_SINGLE
    airpuck_real rates[3], all[3][AIRPUCK_MOVING];
    airpuck_acceleration_slopes(&airpuck_identified, state + 2, state + 6, rates, all);
    for (int axis = 0; axis < 3; axis++)
        memcpy(slopes[axis], all[axis], sizeof slopes[axis]);
#else
    /* Finite differences as in Python, for the same rounding. A float cannot resolve them. */
    const airpuck_real small = plan->difference;
    airpuck_real rates[3], moved[3], motion[4];
    airpuck_acceleration(&airpuck_identified, state + 2, state + 6, rates);
    for (int q = 0; q < 4; q++) {
        memcpy(motion, state + 2, sizeof motion);
        motion[q] += small;
        airpuck_acceleration(&airpuck_identified, motion, state + 6, moved);
        for (int axis = 0; axis < 3; axis++)
            slopes[axis][q] = (moved[axis] - rates[axis]) / small;
    }
#endif
}

/* Return how many periods ahead the craft rejoins the plan. */
static int periods(double time)
{
    double left = plan->duration - time;
    if (plan->rests)
        left = left + plan->later > plan->least ? left + plan->later : plan->least;
    left = left < plan->ahead ? left : plan->ahead;
    int count = (int)(left / (double)airpuck_tuned.period + ROUNDING);
    return count < 1 ? 1 : count > AIRPUCK_PERIODS ? AIRPUCK_PERIODS : count;
}

/* Set the bounds of the corrections in one period: commands have limits. */
static void bound(corrections *p, int period, double time)
{
    airpuck_real asked[MOTORS], least[MOTORS], most[MOTORS];
    for (int i = 0; i < MOTORS; i++) {
        least[i] = airpuck_tuned.command_min;
        most[i] = airpuck_tuned.command_max;
    }
    airpuck_thrust(&airpuck_identified, least, least);
    airpuck_thrust(&airpuck_identified, most, most);
    asked_over(time, asked);
    for (int i = 0; i < MOTORS; i++) {
        airpuck_real low = least[i] - asked[i], high = most[i] - asked[i];
        p->low[period * MOTORS + i] = (low < 0 ? low : 0) / plan->correction;
        p->high[period * MOTORS + i] = (high > 0 ? high : 0) / plan->correction;
    }
}

/* What follows from the end of a period: how errors, and a motor's thrust, change the errors where
 * the craft rejoins the plan. */
typedef struct {
    airpuck_real onward[6][6], running[6][MOTORS];
    airpuck_real state[STATES], force[MOTORS];
} outlook;

/* Move the outlook to the beginning of a period, and set the effect of corrections in it. */
static void look_back(const airpuck *craft, corrections *p, int period, double time, outlook *to)
{
    airpuck_real h = airpuck_tuned.period, lag = airpuck_tuned.motor_lag;
    airpuck_real state[STATES], middle[STATES], force[MOTORS], matrix[3][MOTORS];
    airpuck_real offset[3], slopes[3][4], moved[6][3];
    tracked_at(time, state);
    airpuck_thrust(&airpuck_identified, state + 6, force);
    for (int i = 0; i < STATES; i++)
        middle[i] = (state[i] + to->state[i]) / 2;
    airpuck_acceleration_map(middle[2], 0, matrix, offset);
    accelerations_change(middle, slopes);
    /* After its end a plan has no thrust, but the motors still spin down. */
    airpuck_real flying = (airpuck_real)within((plan->duration - time) / (double)h, 0, 1);
    airpuck_real fading = AIRPUCK_F(exp)(-(airpuck_real)period * h / plan->lasting);
    for (int i = 0; i < 6; i++) {
        for (int axis = 0; axis < 3; axis++) {
            moved[i][axis] = h * h / 2 * to->onward[i][axis] + h * to->onward[i][3 + axis];
            p->missed[i] += moved[i][axis] * fading * craft->disturbance[axis];
        }
        for (int j = 0; j < MOTORS; j++) {
            airpuck_real push = moved[i][0] * matrix[0][j] + moved[i][1] * matrix[1][j] +
                                moved[i][2] * matrix[2][j];
            p->missed[i] += push * (1 - flying) * (to->force[j] + force[j]) / 2;
            p->columns[period * MOTORS + j][i] = plan->correction / plan->precision[i] *
                                            airpuck_tuned.motor_drive *
                                            (push / 2 + to->running[i][j]);
            to->running[i][j] = (1 + lag) / 2 * push + lag * to->running[i][j];
        }
        for (int axis = 0; axis < 3; axis++)
            to->onward[i][3 + axis] += h * to->onward[i][axis];
        for (int q = 0; q < 4; q++)
            for (int axis = 0; axis < 3; axis++)
                to->onward[i][2 + q] += moved[i][axis] * slopes[axis][q];
    }
    memcpy(to->state, state, sizeof state);
    memcpy(to->force, force, sizeof force);
    bound(p, period, time);
}

/* Return x_v for multipliers of A x + missed. */
static airpuck_real corrected(const corrections *p, int v, const airpuck_real price[6])
{
    airpuck_real free = 0;
    for (int i = 0; i < 6; i++)
        free -= p->columns[v][i] * price[i];
    return airpuck_clipped(free, p->low[v], p->high[v]);
}

/* Return the dual function; set its slope. */
static airpuck_real dual(const corrections *p, const airpuck_real price[6], airpuck_real slope[6])
{
    airpuck_real value = 0;
    for (int i = 0; i < 6; i++) {
        value += price[i] * (price[i] / 2 - p->missed[i]);
        slope[i] = price[i] - p->missed[i];
    }
    for (int v = 0; v < p->count; v++) {
        airpuck_real x = corrected(p, v, price), free = 0;
        for (int i = 0; i < 6; i++) {
            free -= p->columns[v][i] * price[i];
            slope[i] -= p->columns[v][i] * x;
        }
        value += x * (free - x / 2);
    }
    return value;
}

/* Set Newton's step: the solution of (I + A A') step = -slope, over corrections within bounds. */
static void newton_step(const corrections *p, const airpuck_real price[6],
                        const airpuck_real slope[6], airpuck_real step[6])
{
    airpuck_real h[6][6] = {{0}};
    for (int i = 0; i < 6; i++)
        h[i][i] = 1;
    for (int v = 0; v < p->count; v++) {
        airpuck_real x = corrected(p, v, price);
        if (!(x > p->low[v] && x < p->high[v]))
            continue;
        for (int i = 0; i < 6; i++)
            for (int j = 0; j <= i; j++)
                h[i][j] += p->columns[v][i] * p->columns[v][j];
    }
    /* Cholesky's factor, in place. */
    for (int j = 0; j < 6; j++)
        for (int i = j; i < 6; i++) {
            for (int k = 0; k < j; k++)
                h[i][j] -= h[i][k] * h[j][k];
            h[i][j] = i == j ? AIRPUCK_F(sqrt)(h[j][j]) : h[i][j] / h[j][j];
        }
    for (int i = 0; i < 6; i++) {
        step[i] = -slope[i];
        for (int k = 0; k < i; k++)
            step[i] -= h[i][k] * step[k];
        step[i] /= h[i][i];
    }
    for (int i = 5; i >= 0; i--) {
        for (int k = i + 1; k < 6; k++)
            step[i] -= h[k][i] * step[k];
        step[i] /= h[i][i];
    }
}

/* Find the multipliers of the least corrections, by Newton's method on the convex dual. It has six
 * unknowns, whatever the number of corrections. */
static void find_price(const corrections *p, airpuck_real price[6])
{
    airpuck_real slope[6], step[6], tried[6], along, share, value, before;
    memset(price, 0, sizeof(airpuck_real) * 6);
    before = dual(p, price, slope);
    for (int pass = 0; pass < plan->iterations; pass++) {
        airpuck_real steepest = 0;
        for (int i = 0; i < 6; i++)
            steepest = AIRPUCK_F(fmax)(steepest, AIRPUCK_F(fabs)(slope[i]));
        if (steepest < TOLERANCE)
            return;
        newton_step(p, price, slope, step);
        along = 0;
        for (int i = 0; i < 6; i++)
            along += slope[i] * step[i];
        for (share = 1;; share /= 2) {
            for (int i = 0; i < 6; i++)
                tried[i] = price[i] + share * step[i];
            value = dual(p, tried, slope);
            airpuck_real margin = ROUNDED * AIRPUCK_F(fabs)(before);
            if (!(value > before + plan->decrease * share * along + margin) ||
                share <= plan->shortest)
                break;
        }
        memcpy(price, tried, sizeof tried);
        before = value;
    }
}

airpuck_status airpuck_track(airpuck *craft, double time, airpuck_real command[AIRPUCK_MOTORS])
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_target target;
    airpuck_real first[STATES], planned[MOTORS], following[MOTORS], now[MOTORS], price[6];
    airpuck_real coasting[MOTORS], least[MOTORS], most[MOTORS];
    corrections p = {.columns = (airpuck_real(*)[6])craft->numbers};
    outlook to;
    if (!(0 <= time && time < plan->given_up)) {
        airpuck_flight_target(time + (double)tuning->period, &target);
        return airpuck_lqr(craft, &target, command);
    }
    p.low = craft->numbers + 6 * AIRPUCK_CORRECTIONS;
    p.high = p.low + AIRPUCK_CORRECTIONS;
    int count = periods(time);
    p.count = count * MOTORS;
    memset(&to, 0, sizeof to);
    for (int i = 0; i < 6; i++)
        to.onward[i][i] = 1;
    tracked_at(time + count * (double)tuning->period, to.state);
    airpuck_thrust(&airpuck_identified, to.state + 6, to.force);
    for (int k = count - 1; k >= 0; k--) {
        memcpy(following, to.force, sizeof following);
        look_back(craft, &p, k, time + k * (double)tuning->period, &to);
    }
    memcpy(first, to.state, sizeof first);
    memcpy(planned, to.force, sizeof planned);
    airpuck_thrust(&airpuck_identified, craft->motor_speed, now);
    airpuck_real error[6];
    for (int i = 0; i < 6; i++)
        error[i] = craft->state[i] - first[i];
    error[2] = airpuck_wrapped(error[2]);
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j < 6; j++)
            p.missed[i] += to.onward[i][j] * error[j];
        for (int j = 0; j < MOTORS; j++)
            p.missed[i] += to.running[i][j] * (now[j] - planned[j]);
        p.missed[i] /= plan->precision[i];
    }
    find_price(&p, price);
    airpuck_thrust_range(craft, coasting, least, most);
    for (int i = 0; i < MOTORS; i++) {
        airpuck_real force = following[i] + tuning->motor_lag * (now[i] - planned[i]) +
                             tuning->motor_drive * plan->correction * corrected(&p, i, price);
        force = airpuck_clipped(force, least[i], most[i]);
        command[i] = airpuck_driven(i, force, coasting[i]);
    }
    memset(craft->request, 0, sizeof craft->request);
    if (airpuck_finite(command, MOTORS))
        return AIRPUCK_EXACT;
    for (int i = 0; i < MOTORS; i++)
        command[i] = tuning->command_min;
    return AIRPUCK_FAILED;
}

#endif
#else
/* C does not allow empty files. */
typedef int airpuck_no_flight;
#endif
