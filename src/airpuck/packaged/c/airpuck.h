/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* The controller of a craft: poses in, motor commands out.
 *
 *     airpuck craft;
 *     airpuck_target targets[AIRPUCK_TARGETS];
 *     airpuck_real command[AIRPUCK_MOTORS];
 *     airpuck_init(&craft);
 *     airpuck_set_point(targets, 0, 0, 0);
 *     ... for every pose: airpuck_pose(&craft, stamp, pose);
 *     ... every airpuck_tuned.period: airpuck_step(&craft, now, targets, command);
 *         send the command, then airpuck_sent(&craft, now, command);
 *
 * No memory is allocated and there are no global variables. Calls for the same craft must not
 * overlap, for example from an interrupt.
 *
 * Times are seconds on the clock of the poses, and double also in single precision: after an hour
 * a float cannot tell frames apart. Differences of times are converted at once. */
#ifndef AIRPUCK_H
#define AIRPUCK_H

#include "airpuck_model.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Number of targets for a control step: one for the allocation, and one for each predicted step. */
#define AIRPUCK_TARGETS (1 + AIRPUCK_STEPS)

/* Outcome of a control step. Up to AIRPUCK_FALLBACK the craft flies; all others idle the motors. */
typedef enum {
    AIRPUCK_EXACT,           /* The requested acceleration is met. */
    AIRPUCK_SCALED,          /* The linear or the angular acceleration is reduced. */
    AIRPUCK_NEAREST,         /* No reduced request can be met; the nearest acceleration is used. */
    AIRPUCK_OPTIMAL,         /* The plan meets all limits. */
    AIRPUCK_SOFTENED,        /* The plan exceeds a limit of the craft's motion. */
    AIRPUCK_ITERATION_LIMIT, /* The solver found no plan; the previous one continues. */
    AIRPUCK_FALLBACK,        /* There is no plan; the thrust allocation steers. */
    AIRPUCK_FAILED,          /* The solver found no thrusts. */
    AIRPUCK_NO_POSE,         /* No pose has been received yet. */
    AIRPUCK_STALE_POSE,      /* The last pose is too old, or too far ahead (longest_pause). */
    AIRPUCK_JUMPING_POSE,    /* The last poses cannot be the craft. */
    AIRPUCK_BAD_INPUT        /* A pose or time is not finite, or targets are missing. */
} airpuck_status;

/* A desired state x, y, yaw and their rates, and the acceleration to feed forward. */
typedef struct {
    airpuck_real state[6];
    airpuck_real acceleration[3];
} airpuck_target;

/* A command and the time from which it acts. */
typedef struct {
    double begins;
    airpuck_real command[AIRPUCK_MOTORS];
} airpuck_held;

/* The filter's estimate at the last pose that it used. */
typedef struct {
    /* Position, velocity and disturbance of x, y and yaw, and the rounding of the position; their
     * covariances L diag(d) L', by d and the entries of L below its diagonal: 10, 20, 21. */
    airpuck_real mean[3][4], diagonal[3][3], lower[3][3];
    airpuck_real motor_speed[AIRPUCK_MOTORS];
} airpuck_belief;

/* Numbers fixed at export: the tuning, and what follows from it. */
typedef struct {
    double transport_delay;                 /* From sending a command to its effect [s]. */
    double longest_pause;                   /* No control without a pose newer than this [s], */
    double blind, moves;                    /* or this, if the craft is faster than that [m/s]. */
    double believed_after;                  /* Poses that agree for this long are accepted [s]. */
    double remembered;                      /* Older commands affect only motor speeds [s]. */
    airpuck_real jump[3];                   /* A pose this far from its prediction is wrong. */
    airpuck_real period;                    /* Time between commands [s]. */
    airpuck_real gain[3][6];                /* Gain of the LQR. */
    airpuck_real motor_lag, motor_drive;    /* Next motor speed: lag * speed + drive * command. */
    airpuck_real command_min, command_max;  /* Range of commands. */
    airpuck_real arm;                       /* Lever arm that scales angular accelerations [m]. */
    airpuck_real slack_root;                /* Square root of the cost of scaling a request. */
    airpuck_real unscaled;                  /* A request is met if both slacks are this near 1. */
    airpuck_real tie_thrust, tie_slack;     /* Weights that choose among equally near solutions. */
    airpuck_real pose_variance[3];          /* Variance of measured poses. */
    airpuck_real initial_variance[3][3];    /* Variance of position, velocity, disturbance. */
    airpuck_real acceleration_density[3];   /* Squared density of unexplained accelerations. */
    airpuck_real disturbance_density[3];    /* Squared density that drives the disturbance. */
} airpuck_tuning;

extern const airpuck_tuning airpuck_tuned;

#if AIRPUCK_STEPS > 0
#include "airpuck_mpc.h"
#include "airpuck_qp.h"
#endif
#if AIRPUCK_INTERVALS > 0
#include "airpuck_flight.h"
#endif

/* Memory of a law that it uses only within a step. */
#if AIRPUCK_STEPS > 0
#define AIRPUCK_WORKING AIRPUCK_QP_ACTIVE(AIRPUCK_COMMANDS, AIRPUCK_ROWS)
#define AIRPUCK_NUMBERS                                                                           \
    (AIRPUCK_QP_NUMBERS(AIRPUCK_COMMANDS, AIRPUCK_ROWS, AIRPUCK_ROWS) +                           \
     (AIRPUCK_SCRATCH > AIRPUCK_FACTOR ? AIRPUCK_SCRATCH : AIRPUCK_FACTOR) - AIRPUCK_FACTOR)
/* States, curvatures and changes of a prediction; they share memory with a factor of the solver. */
#define AIRPUCK_SCRATCH                                                                           \
    (AIRPUCK_STEPS * (AIRPUCK_STATES + AIRPUCK_MOTORS) + AIRPUCK_STATES * AIRPUCK_COMMANDS)
#define AIRPUCK_FACTOR (AIRPUCK_WORKING * (AIRPUCK_WORKING + 1) / 2)
#elif AIRPUCK_INTERVALS > 0
/* Corrections of a planned flight: six numbers and two bounds each. */
#define AIRPUCK_NUMBERS (8 * AIRPUCK_CORRECTIONS)
#endif

/* A controller. The first fields describe the last step; the rest is its memory. */
typedef struct {
    airpuck_status status;
    airpuck_real request[3];                  /* Requested acceleration. */
    airpuck_real state[6];                    /* State predicted for when the command acts. */
    airpuck_real motor_speed[AIRPUCK_MOTORS]; /* Motor speeds at that time. */
    airpuck_real disturbance[3];              /* Acceleration that the model does not explain. */
    int iterations;                           /* Iterations of the last quadratic program. */

    double clock;    /* Latest time known to have passed. */
    double received; /* Stamps of the last pose received, and of the last one used. */
    double used;
    int bad;      /* Whether the last pose was not finite. */
    int doubtful; /* Whether the last pose was too far from its prediction. */
    double speed;          /* In the last step [m/s]. */
    double agreeing_since; /* Since when poses agree with each other. */
    airpuck_real pose[3];  /* The last pose. */

    double filtered;  /* Time of the belief; -INFINITY: none yet. */
    double motors_at; /* Time of the motor speeds, if later; otherwise -INFINITY. */
    airpuck_belief belief;
    int held; /* Number of commands; the first one acts at the time of the belief. */
    airpuck_held commands[AIRPUCK_HELD];
    signed char sides[AIRPUCK_MOTORS + 2]; /* Active bounds of the last thrust allocation. */

#if AIRPUCK_STEPS > 0
    airpuck_plan plan;
#endif
#if AIRPUCK_INTERVALS > 0
    double departs; /* When the planned flight begins. */
#endif
#if AIRPUCK_STEPS > 0 || AIRPUCK_INTERVALS > 0
    airpuck_real numbers[AIRPUCK_NUMBERS];
#endif
#if AIRPUCK_STEPS > 0
    int working[AIRPUCK_WORKING];
#endif
} airpuck;

/* Initialise: motors idle, no pose received. */
void airpuck_init(airpuck *craft);

/* Receive a measured pose x, y [m], yaw [rad].
 *
 * A pose is ignored if it is not finite, not newer than the last, or implausibly far from its
 * prediction. Three exceptions are accepted anywhere: poses that agree with each other for
 * longest_pause, the first pose after such a gap, and a pose older than the last by more. */
void airpuck_pose(airpuck *craft, double stamp, const airpuck_real pose[3]);

/* Receive the command that was actually sent. A command that is not finite counts as not sent. A
 * time that is not finite, or more than longest_pause ahead, is replaced by the present time. */
void airpuck_sent(airpuck *craft, double time, const airpuck_real command[AIRPUCK_MOTORS]);

/* Compute the command to send now.
 *
 * targets[0] is the target one period after the command begins to act, `transport_delay` from now;
 * a prediction uses targets[k] at the end of its step k after that time. There is always a
 * command: it is idle if the craft cannot be steered.
 *
 * targets may be NULL if a plan was exported: the craft then follows the plan. Without a plan the
 * status is AIRPUCK_BAD_INPUT. */
airpuck_status airpuck_step(airpuck *craft, double now,
                            const airpuck_target targets[AIRPUCK_TARGETS],
                            airpuck_real command[AIRPUCK_MOTORS]);

#if AIRPUCK_INTERVALS > 0
/* Set when the planned flight begins. Until then the craft waits at its start, afterwards at its
 * end; after airpuck_init it does not begin. */
void airpuck_depart(airpuck *craft, double time);
#endif

/* Set all targets to a pose at rest. */
void airpuck_set_point(airpuck_target targets[AIRPUCK_TARGETS], airpuck_real x, airpuck_real y,
                       airpuck_real yaw);

/* Return the name of a status. */
const char *airpuck_status_name(airpuck_status status);

#ifdef __cplusplus
}
#endif

#endif
