/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck.h"

#include "airpuck_laws.h"

#include <string.h>

enum { MOTORS = AIRPUCK_MOTORS };
/* A time before all others. */
#define NEVER (-(double)INFINITY)
/* In a shorter time covariances do not change; its powers would underflow in a float [s]. */
#define INSTANT AIRPUCK_R(1e-9)

/* The queue of commands: each is in force until the next begins to act. */

static void drop_commands(airpuck *craft, double time)
{
    int old = 0;
    while (old + 1 < craft->held && craft->commands[old + 1].begins <= time)
        old++;
    craft->held -= old;
    memmove(craft->commands, craft->commands + old, (size_t)craft->held * sizeof(airpuck_held));
}

/* Split the time from `now` to `stop` where commands change. Each call sets the duration and the
 * command of one interval, moves `now` to its end and `next` to the command that follows; it
 * returns whether there was an interval. */
static int next_interval(const airpuck *craft, int *next, double *now, double stop,
                         double *duration, const airpuck_real **command)
{
    if (*next > craft->held)
        return 0;
    for (;; ++*next) {
        const airpuck_held *following = &craft->commands[*next];
        int changes = *next < craft->held && following->begins <= stop;
        *command = craft->commands[*next > 0 ? *next - 1 : 0].command;
        if (changes && !(following->begins > *now))
            continue;
        double end = changes ? following->begins : stop;
        *duration = end - *now;
        *now = end;
        *next = changes ? *next + 1 : craft->held + 1;
        return 1;
    }
}

/* Advance only the motors to a time, if it is later than theirs. */
static void turn_motors(airpuck *craft, double time)
{
    double last = craft->motors_at > NEVER ? craft->motors_at : craft->filtered, duration;
    const airpuck_real *command;
    if (time <= last)
        return;
    for (int next = 0; next_interval(craft, &next, &last, time, &duration, &command);)
        airpuck_motors(&airpuck_identified, craft->belief.motor_speed, command,
                       (airpuck_real)duration);
    craft->motors_at = time;
    drop_commands(craft, time);
}

static void hold(airpuck *craft, double begins, const airpuck_real command[MOTORS])
{
    /* Commands received before, but with later times, had wrong times. */
    while (craft->held > 0 && craft->commands[craft->held - 1].begins >= begins)
        craft->held--;
    if (craft->held == AIRPUCK_HELD)
        turn_motors(craft, craft->commands[1].begins);
    if (craft->held == AIRPUCK_HELD) {
        craft->held--;
        memmove(craft->commands, craft->commands + 1, (size_t)craft->held * sizeof(airpuck_held));
    }
    airpuck_held *last = &craft->commands[craft->held++];
    last->begins = begins;
    memcpy(last->command, command, sizeof last->command);
}

/* The Kalman filter: independent axes with position, velocity and disturbance. */

/* Move the position of an axis. Its last entry is what the sum lost to rounding: a float does not
 * resolve the path of one frame well enough for an estimate of the acceleration. */
static void move(airpuck_real mean[4], airpuck_real change)
{
    airpuck_real before = mean[0];
    change += mean[3];
    mean[0] += change;
    mean[3] = change - (mean[0] - before);
}

/* Advance a mean and motor speeds through an interval with one command, using the acceleration at
 * its middle. */
static void propagate(airpuck_real mean[3][4], airpuck_real speed[MOTORS],
                      const airpuck_real command[MOTORS],
                      airpuck_real h)
{
    airpuck_real middle[MOTORS], rate[3];
    memcpy(middle, speed, sizeof middle);
    airpuck_motors(&airpuck_identified, middle, command, h / 2);
    airpuck_real motion[4] = {mean[2][0] + h / 2 * mean[2][1], mean[0][1], mean[1][1], mean[2][1]};
    airpuck_acceleration(&airpuck_identified, motion, middle, rate);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real *axis_mean = mean[axis], gained = rate[axis] + axis_mean[2];
        move(axis_mean, h * axis_mean[1] + h * h / 2 * gained);
        axis_mean[1] += h * gained;
    }
    airpuck_motors(&airpuck_identified, speed, command, h);
}

static void advance(const airpuck *craft, double time, airpuck_real mean[3][4],
                    airpuck_real speed[MOTORS])
{
    double now = craft->filtered, duration;
    const airpuck_real *command;
    memcpy(mean, craft->belief.mean, sizeof craft->belief.mean);
    memcpy(speed, craft->belief.motor_speed, sizeof craft->belief.motor_speed);
    for (int next = 0; next_interval(craft, &next, &now, time, &duration, &command);)
        propagate(mean, speed, command, (airpuck_real)duration);
}

/* Let the covariance L diag(d) L' of one axis grow over a time without measurements.
 *
 * The covariance itself would lose digits: after a restart, two poses a frame apart reduce the
 * variance of the velocity ten thousandfold. Its factors are sums of squares (Thornton 1976). */
static void spread(airpuck_real d[3], airpuck_real l[3], airpuck_real h, airpuck_real acceleration,
                   airpuck_real disturbance)
{
    airpuck_real h2 = h * h, h3 = h2 * h;
    if (!(h > INSTANT))
        return;
    /* Independent causes, one column each: the errors so far, the unexplained acceleration, and
     * what drives the disturbance, the last two as factors of their covariances over the time. */
    airpuck_real rows[3][8] = {
        {1 + h * l[0] + h2 / 2 * l[1], h + h2 / 2 * l[2], h2 / 2, 1, 0, 1, 0, 0},
        {l[0] + h * l[1], 1 + h * l[2], h, AIRPUCK_R(1.5) / h, 1, AIRPUCK_R(2.5) / h, 1, 0},
        {l[1], l[2], 1, 0, 0, 10 / (3 * h2), 4 / h, 1}};
    airpuck_real variance[8] = {d[0],
                                d[1],
                                d[2],
                                acceleration * h3 / 3,
                                acceleration * h / 4,
                                disturbance * h3 * h2 / 20,
                                disturbance * h3 / 48,
                                disturbance * h / 9};
    for (int j = 0; j < 3; j++) {
        d[j] = 0;
        for (int k = 0; k < 8; k++)
            d[j] += rows[j][k] * rows[j][k] * variance[k];
        for (int i = j + 1; i < 3; i++) {
            airpuck_real sum = 0;
            for (int k = 0; k < 8; k++)
                sum += rows[i][k] * rows[j][k] * variance[k];
            airpuck_real factor = d[j] > 0 ? sum / d[j] : 0;
            for (int k = 0; k < 8; k++)
                rows[i][k] -= factor * rows[j][k];
            l[i + j - 1] = factor;
        }
    }
}

/* Correct one axis by the innovation of its position. */
static void correct(airpuck_real mean[4], airpuck_real d[3], const airpuck_real l[3],
                    airpuck_real innovation, airpuck_real variance)
{
    airpuck_real gain = d[0] / (d[0] + variance);
    move(mean, gain * innovation);
    mean[1] += gain * l[0] * innovation;
    mean[2] += gain * l[1] * innovation;
    d[0] *= variance / (d[0] + variance);
}

static void restart(airpuck *craft, double time, const airpuck_real pose[3])
{
    turn_motors(craft, time);
    craft->motors_at = NEVER;
    craft->filtered = time;
    memset(craft->belief.mean, 0, sizeof craft->belief.mean);
    memset(craft->belief.lower, 0, sizeof craft->belief.lower);
    memcpy(craft->belief.diagonal, airpuck_tuned.initial_variance, sizeof craft->belief.diagonal);
    for (int axis = 0; axis < 3; axis++)
        craft->belief.mean[axis][0] = pose[axis];
}

static void difference(const airpuck_real pose[3], const airpuck_real other[3],
                       airpuck_real result[3])
{
    for (int axis = 0; axis < 2; axis++)
        result[axis] = pose[axis] - other[axis];
    /* Wrapped before, too: a float loses digits in a difference from many turns. */
    result[2] = airpuck_wrapped(airpuck_wrapped(pose[2]) - other[2]);
}

/* Whether a difference of poses is too large for consecutive frames, or not a number: then the
 * estimate is lost, and poses that agree with each other restart it. */
static int is_far(const airpuck_real apart[3])
{
    for (int axis = 0; axis < 3; axis++)
        if (!(AIRPUCK_F(fabs)(apart[axis]) <= airpuck_tuned.jump[axis]))
            return 1;
    return 0;
}

/* Use a pose unless it is too far from its prediction; return whether it was used. */
static int use_pose(airpuck *craft, double time, const airpuck_real pose[3])
{
    airpuck_real mean[3][4], speed[MOTORS], innovation[3];
    if (!(craft->filtered > NEVER) || craft->motors_at > NEVER) {
        restart(craft, time, pose);
        return 1;
    }
    advance(craft, time, mean, speed);
    airpuck_real predicted[3] = {mean[0][0], mean[1][0], mean[2][0]};
    difference(pose, predicted, innovation);
    for (int axis = 0; axis < 3; axis++)
        innovation[axis] -= mean[axis][3];
    if (is_far(innovation))
        return 0;
    airpuck_real elapsed = (airpuck_real)(time - craft->filtered);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real *d = craft->belief.diagonal[axis], *l = craft->belief.lower[axis];
        spread(d, l, elapsed, airpuck_tuned.acceleration_density[axis],
               airpuck_tuned.disturbance_density[axis]);
        correct(mean[axis], d, l, innovation[axis], airpuck_tuned.pose_variance[axis]);
    }
#ifdef AIRPUCK_SINGLE
    /* A float has few digits; whole turns would use some of them. */
    mean[2][0] = airpuck_wrapped(mean[2][0]);
#endif
    memcpy(craft->belief.mean, mean, sizeof mean);
    memcpy(craft->belief.motor_speed, speed, sizeof speed);
    craft->filtered = time;
    drop_commands(craft, time);
    return 1;
}

void airpuck_init(airpuck *craft)
{
    memset(craft, 0, sizeof *craft);
    craft->status = AIRPUCK_NO_POSE;
    craft->clock = craft->received = craft->used = NEVER;
    craft->filtered = craft->motors_at = NEVER;
    craft->held = 1;
    craft->commands[0].begins = NEVER;
    for (int i = 0; i < MOTORS; i++)
        craft->commands[0].command[i] = craft->belief.motor_speed[i] = airpuck_tuned.command_min;
#if AIRPUCK_STEPS > 0
    airpuck_plan_begin(&craft->plan);
#endif
#if AIRPUCK_INTERVALS > 0
    craft->departs = INFINITY;
#endif
}

#if AIRPUCK_INTERVALS > 0
void airpuck_depart(airpuck *craft, double time)
{
    craft->departs = time;
}
#endif

void airpuck_pose(airpuck *craft, double stamp, const airpuck_real pose[3])
{
    double last = craft->received;
    airpuck_real apart[3];
    craft->bad = !(isfinite(stamp) && airpuck_finite(pose, 3));
    if (craft->bad || (last - airpuck_tuned.longest_pause <= stamp && stamp <= last))
        return;
    difference(pose, craft->pose, apart);
    if (!(craft->received > NEVER) || is_far(apart))
        craft->agreeing_since = stamp;
    memcpy(craft->pose, pose, sizeof craft->pose);
    craft->received = stamp;
    craft->clock = stamp > craft->clock ? stamp : craft->clock;
    if (!(fabs(stamp - last) <= airpuck_tuned.longest_pause)) {
        /* The last pose is too old to predict from, or its stamp lies in the future; but a short gap
         * may not have led the prediction astray. */
        if (stamp > last && stamp - last <= airpuck_tuned.blind && !craft->doubtful &&
            use_pose(craft, stamp, pose)) {
            craft->used = stamp;
            return;
        }
    } else if (stamp - craft->used <= airpuck_tuned.longest_pause && use_pose(craft, stamp, pose)) {
        craft->used = stamp;
        craft->doubtful = 0;
        return;
    } else {
        /* An estimate that spins too fast agrees with every few poses: the others count, too. */
        craft->doubtful = 1;
        if (!(stamp - craft->agreeing_since >= airpuck_tuned.believed_after))
            return;
    }
    craft->doubtful = 0;
    craft->used = craft->agreeing_since = stamp;
    restart(craft, stamp, pose);
}

void airpuck_sent(airpuck *craft, double time, const airpuck_real command[MOTORS])
{
    if (!airpuck_finite(command, MOTORS))
        return;
    if (isfinite(craft->clock) &&
        !(time > NEVER && time <= craft->clock + airpuck_tuned.longest_pause))
        time = craft->clock;
    if (!isfinite(time))
        return;
    craft->clock = time > craft->clock ? time : craft->clock;
    hold(craft, time + airpuck_tuned.transport_delay, command);
    /* Run the motors up to the last command that began to act long ago. */
    for (int i = craft->held - 1; i >= 0; i--)
        if (craft->commands[i].begins <= time - airpuck_tuned.remembered) {
            turn_motors(craft, craft->commands[i].begins);
            break;
        }
}

/* Return why the craft cannot be steered; AIRPUCK_EXACT if it can. */
static airpuck_status refusal(airpuck *craft, double now)
{
    if (!isfinite(now))
        return AIRPUCK_BAD_INPUT;
    craft->clock = now;
    if (craft->bad)
        return AIRPUCK_BAD_INPUT;
    if (!(craft->received > NEVER))
        return AIRPUCK_NO_POSE;
    double age = now - craft->received;
    int blind = craft->speed > airpuck_tuned.moves && age >= 0 && age <= airpuck_tuned.blind;
    if (!(fabs(age) <= airpuck_tuned.longest_pause || blind))
        return AIRPUCK_STALE_POSE;
    return craft->doubtful ? AIRPUCK_JUMPING_POSE : AIRPUCK_EXACT;
}

airpuck_status airpuck_step(airpuck *craft, double now,
                            const airpuck_target targets[AIRPUCK_TARGETS],
                            airpuck_real command[MOTORS])
{
    airpuck_real mean[3][4];
    craft->status = refusal(craft, now);
    craft->iterations = 0;
#if AIRPUCK_INTERVALS == 0
    if (targets == NULL)
        craft->status = AIRPUCK_BAD_INPUT;
#endif
    if (craft->status != AIRPUCK_EXACT) {
        for (int i = 0; i < MOTORS; i++)
            command[i] = airpuck_tuned.command_min;
        memset(craft->request, 0, sizeof craft->request);
        craft->speed = 0;
        return craft->status;
    }
    advance(craft, now + airpuck_tuned.transport_delay, mean, craft->motor_speed);
    for (int axis = 0; axis < 3; axis++) {
        craft->state[axis] = mean[axis][0];
        craft->state[3 + axis] = mean[axis][1];
        craft->disturbance[axis] = mean[axis][2];
    }
    craft->speed = sqrt((double)(mean[0][1] * mean[0][1] + mean[1][1] * mean[1][1]));
#if AIRPUCK_INTERVALS > 0
    if (targets == NULL) {
        double since = now + airpuck_tuned.transport_delay - craft->departs;
#if AIRPUCK_STEPS > 0
        airpuck_target planned[AIRPUCK_TARGETS];
        airpuck_flight_target(since + (double)airpuck_tuned.period, planned);
        for (int k = 1; k < AIRPUCK_TARGETS; k++)
            airpuck_flight_target(since + k * (double)airpuck_predicted.step, &planned[k]);
        return craft->status = airpuck_mpc(craft, now, planned, command);
#else
        return craft->status = airpuck_track(craft, since, command);
#endif
    }
#endif
#if AIRPUCK_STEPS > 0
    craft->status = airpuck_mpc(craft, now, targets, command);
#else
    craft->status = airpuck_lqr(craft, targets, command);
#endif
    return craft->status;
}

void airpuck_set_point(airpuck_target targets[AIRPUCK_TARGETS], airpuck_real x, airpuck_real y,
                       airpuck_real yaw)
{
    const airpuck_target target = {{x, y, yaw, 0, 0, 0}, {0, 0, 0}};
    for (int i = 0; i < AIRPUCK_TARGETS; i++)
        targets[i] = target;
}

const char *airpuck_status_name(airpuck_status status)
{
    static const char *const names[] = {
        "exact",  "scaled",  "nearest",    "optimal",      "softened",  "iteration limit",
        "fallback", "failed", "no pose", "stale pose", "jumping pose", "bad input",
    };
    return names[status];
}
