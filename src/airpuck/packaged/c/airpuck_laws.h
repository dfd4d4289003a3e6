/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* The laws, and the few functions that they share with the rest of the controller. */
#ifndef AIRPUCK_LAWS_H
#define AIRPUCK_LAWS_H

#include "airpuck.h"

/* Compute a command from the prediction in `craft`; set craft->request. */
airpuck_status airpuck_lqr(airpuck *craft, const airpuck_target *target,
                           airpuck_real command[AIRPUCK_MOTORS]);

#if AIRPUCK_STEPS > 0
/* The first plan. */
void airpuck_plan_begin(airpuck_plan *plan);

/* Compute a command by the predictive law, or by airpuck_lqr if there is no plan. */
airpuck_status airpuck_mpc(airpuck *craft, double now,
                           const airpuck_target targets[AIRPUCK_TARGETS],
                           airpuck_real command[AIRPUCK_MOTORS]);
#endif

#if AIRPUCK_INTERVALS > 0
/* Compute a command that tracks the plan, at a time since its beginning. */
airpuck_status airpuck_track(airpuck *craft, double time, airpuck_real command[AIRPUCK_MOTORS]);

/* Set the plan's state and acceleration at a time since its beginning. */
void airpuck_flight_target(double time, airpuck_target *target);
#endif

/* Accelerations are matrix * thrusts + offset, without effects, which count as a disturbance. */
void airpuck_acceleration_map(airpuck_real yaw, airpuck_real spin,
                              airpuck_real matrix[3][AIRPUCK_MOTORS], airpuck_real offset[3]);

/* Set the motors' speeds one period later without a command, and the least and largest thrusts that
 * they can then have. */
void airpuck_thrust_range(const airpuck *craft, airpuck_real coasting[AIRPUCK_MOTORS],
                          airpuck_real least[AIRPUCK_MOTORS], airpuck_real most[AIRPUCK_MOTORS]);

/* Return the command for a thrust one period later. */
airpuck_real airpuck_driven(int motor, airpuck_real force, airpuck_real coasting);

/* Return an angle wrapped to between -pi and pi. */
airpuck_real airpuck_wrapped(airpuck_real angle);

/* Return a number clipped to a range; NaN stays NaN. */
airpuck_real airpuck_clipped(airpuck_real number, airpuck_real least, airpuck_real most);

/* Return whether all numbers are finite. */
int airpuck_finite(const airpuck_real *numbers, int count);

#endif
