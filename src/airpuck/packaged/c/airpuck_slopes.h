/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Derivatives of the equations of motion, for the linearisation along a plan. */
#ifndef AIRPUCK_SLOPES_H
#define AIRPUCK_SLOPES_H

#include "airpuck_model.h"

/* Accelerations depend on yaw, vx, vy, yaw rate and motor speeds; a step also on commands. */
#define AIRPUCK_MOVING (4 + AIRPUCK_MOTORS)
#define AIRPUCK_STEERED (AIRPUCK_MOVING + AIRPUCK_MOTORS)

/* Compute accelerations (see airpuck_acceleration), and their derivatives with respect to motion
 * and speeds. */
void airpuck_acceleration_slopes(const airpuck_model *model, const airpuck_real motion[4],
                                 const airpuck_real speed[AIRPUCK_MOTORS], airpuck_real rates[3],
                                 airpuck_real slopes[3][AIRPUCK_MOVING]);

/* Derivatives of airpuck_model_step: of x, y, yaw and their rates with respect to motion, speeds
 * and commands, and of each motor speed with respect to itself and its command. Those with respect
 * to the position are left out: they are 1 for the position itself, and otherwise 0. */
void airpuck_step_slopes(const airpuck_model *model, const airpuck_real state[AIRPUCK_STATES],
                         const airpuck_real command[AIRPUCK_MOTORS], airpuck_real duration,
                         airpuck_real slopes[6][AIRPUCK_STEERED],
                         airpuck_real by_speed[AIRPUCK_MOTORS],
                         airpuck_real by_command[AIRPUCK_MOTORS]);

#endif
