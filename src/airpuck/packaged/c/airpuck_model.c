/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_model.h"


/* Velocity in the body frame. */
typedef struct {
    airpuck_real forward, left, spin;
} body_motion;

void airpuck_thrust(const airpuck_model *model, const airpuck_real speed[AIRPUCK_MOTORS],
                    airpuck_real force[AIRPUCK_MOTORS])
{
    for (int i = 0; i < AIRPUCK_MOTORS; i++) {
        airpuck_real total = 0;
        for (int power = AIRPUCK_DEGREE - 1; power >= 0; power--)
            total = (total + model->thrust[i][power]) * speed[i];
        force[i] = total;
    }
}

/* Thrust falls as a propeller moves into its own inflow. */
static void reduce_by_inflow(const airpuck_model *model, const body_motion *felt,
                             airpuck_real force[AIRPUCK_MOTORS])
{
    for (int i = 0; i < AIRPUCK_MOTORS; i++) {
        const airpuck_real *axis = model->inflow_axes[i];
        airpuck_real axial = axis[0] * felt->forward + axis[1] * felt->left + axis[2] * felt->spin;
        force[i] *= 1 - model->inflow * axial;
    }
}

/* A propeller loses thrust when its twin blows into it. */
static void reduce_by_twins(const airpuck_model *model, airpuck_real force[AIRPUCK_MOTORS])
{
    airpuck_real alone[AIRPUCK_MOTORS];
    for (int i = 0; i < AIRPUCK_MOTORS; i++)
        alone[i] = model->newtons[i] * force[i];
    for (int i = 0; i < AIRPUCK_MOTORS; i++)
        if (model->twin[i] >= 0)
            force[i] /= 1 + model->pair_interaction * alone[model->twin[i]];
}

/* The battery's voltage drops under load, and every thrust with its square. */
static void reduce_by_voltage(const airpuck_model *model, airpuck_real force[AIRPUCK_MOTORS])
{
    airpuck_real total = 0;
    for (int i = 0; i < AIRPUCK_MOTORS; i++)
        total += model->newtons[i] * force[i];
    airpuck_real left = 2 / (1 + AIRPUCK_F(sqrt)(1 + 4 * model->voltage_sag * total));
    for (int i = 0; i < AIRPUCK_MOTORS; i++)
        force[i] *= left * left;
}

void airpuck_acceleration(const airpuck_model *model, const airpuck_real motion[4],
                          const airpuck_real speed[AIRPUCK_MOTORS], airpuck_real rates[3])
{
    airpuck_real cosine = AIRPUCK_F(cos)(motion[0]), sine = AIRPUCK_F(sin)(motion[0]);
    body_motion felt = {cosine * motion[1] + sine * motion[2],
                        cosine * motion[2] - sine * motion[1], motion[3]};
    airpuck_real force[AIRPUCK_MOTORS];
    airpuck_thrust(model, speed, force);
    if (model->inflow != 0)
        reduce_by_inflow(model, &felt, force);
    if (model->pair_interaction != 0)
        reduce_by_twins(model, force);
    if (model->voltage_sag != 0)
        reduce_by_voltage(model, force);

    airpuck_real body[3];
    for (int axis = 0; axis < 3; axis++) {
        body[axis] = 0;
        for (int i = 0; i < AIRPUCK_MOTORS; i++)
            body[axis] += model->configuration[axis][i] * force[i];
    }
    const airpuck_real *drag = model->drag;
    airpuck_real velocity =
        AIRPUCK_F(sqrt)(felt.forward * felt.forward + felt.left * felt.left + AIRPUCK_AT_REST);
    body[0] -= (drag[0] + drag[1] * velocity) * felt.forward;
    body[1] -= (drag[0] + drag[1] * velocity) * felt.left;
    body[2] -= (drag[2] + drag[3] * AIRPUCK_F(fabs)(felt.spin)) * felt.spin;

    airpuck_real rx, ry;
    airpuck_center_of_mass(model, cosine, sine, &rx, &ry);
    airpuck_real square = felt.spin * felt.spin;
    rates[0] = cosine * body[0] - sine * body[1] + ry * body[2] + rx * square + model->slope[0];
    rates[1] = sine * body[0] + cosine * body[1] - rx * body[2] + ry * square + model->slope[1];
    rates[2] = body[2];
}

void airpuck_center_of_mass(const airpuck_model *model, airpuck_real cosine, airpuck_real sine,
                            airpuck_real *rx, airpuck_real *ry)
{
    airpuck_real x = model->center_of_mass[0], y = model->center_of_mass[1];
    *rx = model->center_of_mass_turns ? cosine * x - sine * y : x;
    *ry = model->center_of_mass_turns ? sine * x + cosine * y : y;
}

static airpuck_real lag_at(const airpuck_model *model, airpuck_real speed)
{
    airpuck_real lag = model->motor_time_constant;
    if (model->idle_lag == 0)
        return lag;
    return lag * (1 + model->idle_lag * AIRPUCK_F(exp)(-speed / model->idle_speed));
}

/* Return the speed of one motor after a duration with a given lag. */
static airpuck_real followed(airpuck_real speed, airpuck_real command, airpuck_real duration,
                             airpuck_real lag)
{
    if (lag > AIRPUCK_NO_LAG)
        return command + (speed - command) * AIRPUCK_F(exp)(-duration / lag);
    return command;
}

void airpuck_motors(const airpuck_model *model, airpuck_real speed[AIRPUCK_MOTORS],
                    const airpuck_real command[AIRPUCK_MOTORS], airpuck_real duration)
{
    for (int i = 0; i < AIRPUCK_MOTORS; i++) {
        /* A lag that depends on the speed is taken in the middle of the step. */
        airpuck_real lag = lag_at(model, speed[i]);
        if (model->idle_lag != 0)
            lag = lag_at(model, followed(speed[i], command[i], duration / 2, lag));
        speed[i] = followed(speed[i], command[i], duration, lag);
    }
}

/* Rates of yaw, vx, vy and yaw rate. */
static void motion_rates(const airpuck_model *model, const airpuck_real motion[4],
                         const airpuck_real speed[AIRPUCK_MOTORS], airpuck_real rates[4])
{
    rates[0] = motion[3];
    airpuck_acceleration(model, motion, speed, rates + 1);
}

static void moved(const airpuck_real motion[4], airpuck_real duration, const airpuck_real rates[4],
                  airpuck_real result[4])
{
    for (int i = 0; i < 4; i++)
        result[i] = motion[i] + duration * rates[i];
}

void airpuck_model_step(const airpuck_model *model, airpuck_real state[AIRPUCK_STATES],
                        const airpuck_real command[AIRPUCK_MOTORS], airpuck_real duration)
{
    airpuck_real half = duration / 2, *motion = state + 2, *begin = state + 6;
    airpuck_real middle[AIRPUCK_MOTORS], end[AIRPUCK_MOTORS];
    for (int i = 0; i < AIRPUCK_MOTORS; i++) {
        /* A motor without lag has its new speed from the start of the step. */
        if (!(model->motor_time_constant > 0))
            begin[i] = command[i];
        middle[i] = end[i] = begin[i];
    }
    airpuck_motors(model, middle, command, half);
    airpuck_motors(model, end, command, duration);

    airpuck_real k1[4], k2[4], k3[4], k4[4], stage[4];
    motion_rates(model, motion, begin, k1);
    moved(motion, half, k1, stage);
    motion_rates(model, stage, middle, k2);
    moved(motion, half, k2, stage);
    motion_rates(model, stage, middle, k3);
    moved(motion, duration, k3, stage);
    motion_rates(model, stage, end, k4);

    /* No rate depends on the position, so its stages are sums of the velocity's stages. */
    for (int i = 0; i < 2; i++)
        state[i] += duration * motion[1 + i] +
                    duration * duration / 6 * (k1[1 + i] + k2[1 + i] + k3[1 + i]);
    for (int i = 0; i < 4; i++)
        motion[i] += duration / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
    for (int i = 0; i < AIRPUCK_MOTORS; i++)
        begin[i] = end[i];
}

void airpuck_predict(const airpuck_model *model, airpuck_real state[AIRPUCK_STATES],
                     const airpuck_real *commands, const airpuck_real *durations, int count)
{
    for (int i = 0; i < count; i++)
        airpuck_model_step(model, state, commands + i * AIRPUCK_MOTORS, durations[i]);
}
