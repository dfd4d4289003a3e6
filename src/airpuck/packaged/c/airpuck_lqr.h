/* The law of the regulator: accelerations that lead to the target, thrusts that produce them. */
#ifndef AIRPUCK_LQR_H
#define AIRPUCK_LQR_H

#include "airpuck.h"

/* Compute a command from the prediction in `craft`; set craft->request. */
airpuck_status airpuck_lqr(airpuck *craft, const airpuck_target *target,
                           airpuck_real command[AIRPUCK_MOTORS]);

/* An angle, shifted by whole turns to between -pi and pi. */
airpuck_real airpuck_wrapped(airpuck_real angle);

/* A number, moved into a range; not a number remains. */
airpuck_real airpuck_clipped(airpuck_real number, airpuck_real least, airpuck_real most);

/* Whether all numbers are finite. */
int airpuck_finite(const airpuck_real *numbers, int count);

#endif
