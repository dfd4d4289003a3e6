/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_slopes.h"

#include <string.h>

enum { MOTORS = AIRPUCK_MOTORS, MOVING = AIRPUCK_MOVING, STEERED = AIRPUCK_STEERED };

/* Velocity in the body frame, and its derivatives with respect to yaw, vx, vy and yaw rate. */
typedef struct {
    airpuck_real forward, left, spin;
    airpuck_real forward_slopes[4], left_slopes[4];
} body_motion;

/* Multiply each force by a factor whose derivatives are given. */
static void scale(airpuck_real *force, airpuck_real slopes[MOVING], airpuck_real factor,
                  const airpuck_real factor_slopes[MOVING])
{
    for (int q = 0; q < MOVING; q++)
        slopes[q] = slopes[q] * factor + *force * factor_slopes[q];
    *force *= factor;
}

static void thrusts(const airpuck_model *model, const airpuck_real speed[MOTORS],
                    airpuck_real force[MOTORS], airpuck_real slopes[MOTORS][MOVING])
{
    airpuck_thrust(model, speed, force);
    memset(slopes, 0, sizeof(airpuck_real) * MOTORS * MOVING);
    for (int i = 0; i < MOTORS; i++)
        for (int power = AIRPUCK_DEGREE - 1; power >= 0; power--)
            slopes[i][4 + i] = slopes[i][4 + i] * speed[i] +
                               (airpuck_real)(power + 1) * model->thrust[i][power];
}

static void reduce_by_inflow(const airpuck_model *model, const body_motion *felt,
                             airpuck_real force[MOTORS], airpuck_real slopes[MOTORS][MOVING])
{
    for (int i = 0; i < MOTORS; i++) {
        const airpuck_real *axis = model->inflow_axes[i];
        airpuck_real axial = axis[0] * felt->forward + axis[1] * felt->left + axis[2] * felt->spin;
        airpuck_real by[MOVING] = {0};
        for (int q = 0; q < 4; q++)
            by[q] = -model->inflow *
                    (axis[0] * felt->forward_slopes[q] + axis[1] * felt->left_slopes[q]);
        by[3] -= model->inflow * axis[2];
        scale(&force[i], slopes[i], 1 - model->inflow * axial, by);
    }
}

static void reduce_by_twins(const airpuck_model *model, airpuck_real force[MOTORS],
                            airpuck_real slopes[MOTORS][MOVING])
{
    airpuck_real alone[MOTORS], alone_slopes[MOTORS][MOVING];
    for (int i = 0; i < MOTORS; i++) {
        alone[i] = model->newtons[i] * force[i];
        for (int q = 0; q < MOVING; q++)
            alone_slopes[i][q] = model->newtons[i] * slopes[i][q];
    }
    for (int i = 0; i < MOTORS; i++) {
        int twin = model->twin[i];
        if (twin < 0)
            continue;
        airpuck_real factor = 1 / (1 + model->pair_interaction * alone[twin]), by[MOVING];
        for (int q = 0; q < MOVING; q++)
            by[q] = -factor * factor * model->pair_interaction * alone_slopes[twin][q];
        scale(&force[i], slopes[i], factor, by);
    }
}

static void reduce_by_voltage(const airpuck_model *model, airpuck_real force[MOTORS],
                              airpuck_real slopes[MOTORS][MOVING])
{
    airpuck_real total = 0, total_slopes[MOVING] = {0}, by[MOVING];
    for (int i = 0; i < MOTORS; i++) {
        total += model->newtons[i] * force[i];
        for (int q = 0; q < MOVING; q++)
            total_slopes[q] += model->newtons[i] * slopes[i][q];
    }
    airpuck_real root = AIRPUCK_F(sqrt)(1 + 4 * model->voltage_sag * total);
    airpuck_real left = 2 / (1 + root);
    /* The factor is left^2, and left' = -left^2 / 2 * root', root' = 2 sag total' / root. */
    for (int q = 0; q < MOVING; q++)
        by[q] = -2 * left * left * left * model->voltage_sag * total_slopes[q] / root;
    for (int i = 0; i < MOTORS; i++)
        scale(&force[i], slopes[i], left * left, by);
}

static void resist(const airpuck_model *model, const body_motion *felt, airpuck_real body[3],
                   airpuck_real slopes[3][MOVING])
{
    const airpuck_real *drag = model->drag;
    airpuck_real velocity =
        AIRPUCK_F(sqrt)(felt->forward * felt->forward + felt->left * felt->left + AIRPUCK_AT_REST);
    airpuck_real resistance = drag[0] + drag[1] * velocity, spin = AIRPUCK_F(fabs)(felt->spin);
    body[0] -= resistance * felt->forward;
    body[1] -= resistance * felt->left;
    body[2] -= (drag[2] + drag[3] * spin) * felt->spin;
    for (int q = 0; q < 4; q++) {
        airpuck_real forward = felt->forward_slopes[q], left = felt->left_slopes[q];
        airpuck_real faster = (felt->forward * forward + felt->left * left) / velocity;
        slopes[0][q] -= resistance * forward + drag[1] * faster * felt->forward;
        slopes[1][q] -= resistance * left + drag[1] * faster * felt->left;
    }
    slopes[2][3] -= drag[2] + 2 * drag[3] * spin;
}

void airpuck_acceleration_slopes(const airpuck_model *model, const airpuck_real motion[4],
                                 const airpuck_real speed[MOTORS], airpuck_real rates[3],
                                 airpuck_real slopes[3][MOVING])
{
    airpuck_real cosine = AIRPUCK_F(cos)(motion[0]), sine = AIRPUCK_F(sin)(motion[0]);
    airpuck_real forward = cosine * motion[1] + sine * motion[2];
    airpuck_real left = cosine * motion[2] - sine * motion[1];
    const body_motion felt = {
        forward, left, motion[3], {left, cosine, sine, 0}, {-forward, -sine, cosine, 0}};
    airpuck_real force[MOTORS], force_slopes[MOTORS][MOVING];
    airpuck_real body[3] = {0}, body_slopes[3][MOVING] = {{0}};
    thrusts(model, speed, force, force_slopes);
    if (model->inflow != 0)
        reduce_by_inflow(model, &felt, force, force_slopes);
    if (model->pair_interaction != 0)
        reduce_by_twins(model, force, force_slopes);
    if (model->voltage_sag != 0)
        reduce_by_voltage(model, force, force_slopes);
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < MOTORS; i++) {
            body[axis] += model->configuration[axis][i] * force[i];
            for (int q = 0; q < MOVING; q++)
                body_slopes[axis][q] += model->configuration[axis][i] * force_slopes[i][q];
        }
    resist(model, &felt, body, body_slopes);

    airpuck_real rx, ry, square = felt.spin * felt.spin;
    airpuck_center_of_mass(model, cosine, sine, &rx, &ry);
    rates[0] = cosine * body[0] - sine * body[1] + ry * body[2] + rx * square + model->slope[0];
    rates[1] = sine * body[0] + cosine * body[1] - rx * body[2] + ry * square + model->slope[1];
    rates[2] = body[2];
    for (int q = 0; q < MOVING; q++) {
        airpuck_real *by = body_slopes[0], *across = body_slopes[1], *turned = body_slopes[2];
        slopes[0][q] = cosine * by[q] - sine * across[q] + ry * turned[q];
        slopes[1][q] = sine * by[q] + cosine * across[q] - rx * turned[q];
        slopes[2][q] = turned[q];
    }
    slopes[0][0] -= sine * body[0] + cosine * body[1];
    slopes[1][0] += cosine * body[0] - sine * body[1];
    if (model->center_of_mass_turns) {
        slopes[0][0] += rx * body[2] - ry * square;
        slopes[1][0] += ry * body[2] + rx * square;
    }
    slopes[0][3] += 2 * rx * felt.spin;
    slopes[1][3] += 2 * ry * felt.spin;
}

/* Advance one motor (see airpuck_motors); set derivatives with respect to speed and command. */
static airpuck_real follow(const airpuck_model *model, airpuck_real speed, airpuck_real command,
                           airpuck_real duration, airpuck_real *by_speed, airpuck_real *by_command)
{
    airpuck_real lag = model->motor_time_constant, apart = speed - command;
    airpuck_real lag_by_speed = 0, lag_by_command = 0;
    if (!(lag > AIRPUCK_NO_LAG)) {
        *by_speed = 0;
        *by_command = 1;
        return command;
    }
    if (model->idle_lag != 0) {
        airpuck_real longer = lag * model->idle_lag, idle = model->idle_speed;
        airpuck_real at_begin = longer * AIRPUCK_F(exp)(-speed / idle), first = lag + at_begin;
        airpuck_real half = duration / 2, decay = AIRPUCK_F(exp)(-half / first);
        airpuck_real middle = command + apart * decay;
        airpuck_real middle_by_speed =
            decay - apart * decay * half / (first * first) * at_begin / idle;
        airpuck_real at_middle = longer * AIRPUCK_F(exp)(-middle / idle);
        lag += at_middle;
        lag_by_speed = -at_middle / idle * middle_by_speed;
        lag_by_command = -at_middle / idle * (1 - decay);
    }
    airpuck_real decay = AIRPUCK_F(exp)(-duration / lag);
    airpuck_real by_lag = apart * decay * duration / (lag * lag);
    *by_speed = decay + by_lag * lag_by_speed;
    *by_command = 1 - decay + by_lag * lag_by_command;
    return command + apart * decay;
}

/* Motor speeds at one stage of a step, with their derivatives. */
typedef struct {
    airpuck_real speed[MOTORS], by_speed[MOTORS], by_command[MOTORS];
} motor_stage;

/* Rates of yaw, vx, vy, yaw rate at one stage, and their derivatives. */
typedef struct {
    airpuck_real rates[4], slopes[4][STEERED];
} body_stage;

/* Evaluate the rates at a motion with given derivatives. */
static void evaluate(const airpuck_model *model, const airpuck_real motion[4],
                     airpuck_real motion_slopes[4][STEERED], const motor_stage *motors,
                     body_stage *result)
{
    airpuck_real slopes[3][MOVING];
    result->rates[0] = motion[3];
    airpuck_acceleration_slopes(model, motion, motors->speed, result->rates + 1, slopes);
    memcpy(result->slopes[0], motion_slopes[3], sizeof result->slopes[0]);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real *row = result->slopes[1 + axis];
        for (int p = 0; p < STEERED; p++) {
            row[p] = 0;
            for (int q = 0; q < 4; q++)
                row[p] += slopes[axis][q] * motion_slopes[q][p];
        }
        for (int i = 0; i < MOTORS; i++) {
            row[4 + i] += slopes[axis][4 + i] * motors->by_speed[i];
            row[MOVING + i] += slopes[axis][4 + i] * motors->by_command[i];
        }
    }
}

void airpuck_step_slopes(const airpuck_model *model, const airpuck_real state[AIRPUCK_STATES],
                         const airpuck_real command[MOTORS], airpuck_real duration,
                         airpuck_real slopes[6][STEERED], airpuck_real by_speed[MOTORS],
                         airpuck_real by_command[MOTORS])
{
    const airpuck_real *begin = state + 2, h = duration;
    const airpuck_real after[4] = {0, h / 2, h / 2, h}, share[4] = {1, 2, 2, 1};
    motor_stage motors[3];
    for (int i = 0; i < MOTORS; i++) {
        int lags = model->motor_time_constant > 0;
        airpuck_real first = lags ? state[6 + i] : command[i];
        motors[0].speed[i] = first;
        motors[0].by_speed[i] = lags ? 1 : 0;
        motors[0].by_command[i] = lags ? 0 : 1;
        for (int stage = 1; stage < 3; stage++) {
            airpuck_real *own = &motors[stage].by_speed[i], *given = &motors[stage].by_command[i];
            motors[stage].speed[i] =
                follow(model, first, command[i], stage == 1 ? h / 2 : h, own, given);
            *given += *own * motors[0].by_command[i];
            *own *= motors[0].by_speed[i];
        }
        by_speed[i] = motors[2].by_speed[i];
        by_command[i] = motors[2].by_command[i];
    }
    body_stage body = {{0}, {{0}}};
    memset(slopes, 0, sizeof(airpuck_real) * 6 * STEERED);
    for (int axis = 0; axis < 2; axis++)
        slopes[axis][1 + axis] = h;
    for (int q = 0; q < 4; q++)
        slopes[2 + q][q] = 1;
    for (int stage = 0; stage < 4; stage++) {
        airpuck_real motion[4], motion_slopes[4][STEERED];
        for (int q = 0; q < 4; q++) {
            motion[q] = begin[q] + after[stage] * body.rates[q];
            for (int p = 0; p < STEERED; p++)
                motion_slopes[q][p] = after[stage] * body.slopes[q][p] + (airpuck_real)(p == q);
        }
        evaluate(model, motion, motion_slopes, &motors[stage == 0 ? 0 : stage == 3 ? 2 : 1], &body);
        for (int p = 0; p < STEERED; p++) {
            for (int q = 0; q < 4; q++)
                slopes[2 + q][p] += h / 6 * share[stage] * body.slopes[q][p];
            for (int axis = 0; axis < 2 && stage < 3; axis++)
                slopes[axis][p] += h * h / 6 * body.slopes[1 + axis][p];
        }
    }
}
