/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Motion of a craft under given commands: the equations of motion and their integration.
 *
 * No memory is allocated and no state is kept: all functions work on the caller's arrays.
 *
 * A state has AIRPUCK_STATES entries: x, y [m], yaw [rad], vx, vy [m/s], yaw rate [rad/s], all of
 * the craft's geometric centre in the frame of the table, and the normalised speed of each motor.
 * A command has one number in [0, 1] for each motor. */
#ifndef AIRPUCK_MODEL_H
#define AIRPUCK_MODEL_H

#include "airpuck_real.h"
#include "airpuck_sizes.h"

#ifdef __cplusplus
extern "C" {
#endif

#define AIRPUCK_STATES (6 + AIRPUCK_MOTORS)
/* A motor with a shorter lag follows its command at once [s]. */
#define AIRPUCK_NO_LAG AIRPUCK_R(1e-12)
/* Keeps the speed in the quadratic drag differentiable at rest [m^2/s^2]. */
#define AIRPUCK_AT_REST AIRPUCK_R(1e-12)

/* Coefficients of the equations of motion. A coefficient of 0 switches an effect off. */
typedef struct {
    /* Thrust as a polynomial of motor speed: coefficients of phi, phi^2, ... [N]. */
    airpuck_real thrust[AIRPUCK_MOTORS][AIRPUCK_DEGREE];
    /* Maps thrusts to body accelerations [1/kg, 1/kg] and angular acceleration [1/(kg m)]. */
    airpuck_real configuration[3][AIRPUCK_MOTORS];
    /* From the geometric centre to the centre of mass [m]. */
    airpuck_real center_of_mass[2];
    /* 1: center_of_mass turns with the craft. 0: it is constant in the frame of the table. */
    int center_of_mass_turns;
    /* Lag of motor speed behind its command [s]. */
    airpuck_real motor_time_constant;
    /* Relative increase of the lag at standstill, and motor speed over which it fades. */
    airpuck_real idle_lag, idle_speed;
    /* Inflow: relative loss of thrust per air speed along the thrust [s/m]; and for each motor the
     * factors of forward, left and yaw rate in that speed. */
    airpuck_real inflow;
    airpuck_real inflow_axes[AIRPUCK_MOTORS][3];
    /* Interaction of opposing motors: loss per thrust of the twin [1/N]; -1: no twin. */
    airpuck_real pair_interaction;
    int twin[AIRPUCK_MOTORS];
    /* Fraction of the battery's voltage lost per thrust [1/N]. */
    airpuck_real voltage_sag;
    /* Factors that convert thrusts to newtons, where thrust and configuration share a scale. */
    airpuck_real newtons[AIRPUCK_MOTORS];
    /* Drag: linear [1/s], quadratic [1/m], of the yaw rate [1/s], quadratic [1/rad]. */
    airpuck_real drag[4];
    /* Acceleration by the slope of the table along x and y [m/s^2]. */
    airpuck_real slope[2];
} airpuck_model;

/* The exported model. */
extern const airpuck_model airpuck_identified;

/* Thrusts [N] of motors at given speeds, without effects. */
void airpuck_thrust(const airpuck_model *model, const airpuck_real speed[AIRPUCK_MOTORS],
                    airpuck_real force[AIRPUCK_MOTORS]);

/* Acceleration ax, ay [m/s^2] of the geometric centre in the frame of the table, and angular
 * acceleration [rad/s^2]; motion: yaw, vx, vy, yaw rate. */
void airpuck_acceleration(const airpuck_model *model, const airpuck_real motion[4],
                          const airpuck_real speed[AIRPUCK_MOTORS], airpuck_real rates[3]);

/* Offset of the centre of mass in the frame of the table [m], from cosine and sine of the yaw. */
void airpuck_center_of_mass(const airpuck_model *model, airpuck_real cosine, airpuck_real sine,
                            airpuck_real *rx, airpuck_real *ry);

/* Advance motor speeds under a command held for a duration [s]. */
void airpuck_motors(const airpuck_model *model, airpuck_real speed[AIRPUCK_MOTORS],
                    const airpuck_real command[AIRPUCK_MOTORS], airpuck_real duration);

/* Advance a state under a command held for a duration [s], by one Runge-Kutta step of fourth order.
 * Motors are integrated exactly. Steps up to 10 ms are accurate for a craft of this size. */
void airpuck_model_step(const airpuck_model *model, airpuck_real state[AIRPUCK_STATES],
                        const airpuck_real command[AIRPUCK_MOTORS], airpuck_real duration);

/* Advance a state under `count` commands, one row of AIRPUCK_MOTORS numbers each, held for the
 * given durations [s]; one step for each command. */
void airpuck_predict(const airpuck_model *model, airpuck_real state[AIRPUCK_STATES],
                     const airpuck_real *commands, const airpuck_real *durations, int count);

#ifdef __cplusplus
}
#endif

#endif
