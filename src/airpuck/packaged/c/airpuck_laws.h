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

/* Return an angle wrapped to between -pi and pi. */
airpuck_real airpuck_wrapped(airpuck_real angle);

/* Return a number clipped to a range; NaN stays NaN. */
airpuck_real airpuck_clipped(airpuck_real number, airpuck_real least, airpuck_real most);

/* Return whether all numbers are finite. */
int airpuck_finite(const airpuck_real *numbers, int count);

#endif
