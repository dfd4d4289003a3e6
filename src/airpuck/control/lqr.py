"""The law of the paper's controller (seq:control): regulator, thrust allocation, inverse thrust.

The stages of a control step around the quadratic program are pure functions over an array
namespace; see docs/control.md, "One control step". Point mass and motors are discretised exactly,
for held inputs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
import pydantic
from jaxtyping import Float, Num

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section
from airpuck.compute.compiled import Applied, program
from airpuck.control.allocation import ThrustAllocator, all_finite, problem
from airpuck.control.law import Law, LawOptions, Moment, Step
from airpuck.control.tuning import LawSettings, Tuning, scaled
from airpuck.model.model_file import Model
from airpuck.physics.motor import lag_decay
from airpuck.physics.rigid_body import Dynamics, acceleration_map, pose_difference
from airpuck.physics.thrust import InverseThrust, inverse_thrust, thrust

#: Bounds of the effectiveness used by the allocation. A motor that seems dead still gets a small
#: request, so that the controller notices when it recovers; no estimate may make the controller
#: timid.
_EFFECTIVENESS = (0.1, 1.5)


# Beyond these bounds the Riccati equation cannot be solved in double precision.
CostWeight = Annotated[float, pydantic.Field(ge=0, le=1e6)]
PositiveWeight = Annotated[float, pydantic.Field(ge=1e-6, le=1e6)]


class Weights(Section):
    """Weights of the linear-quadratic regulator, on squared errors and inputs.

    From 1e-6 to 1e6; weights of the rates may be zero.
    """

    #: Weights of x and y [1/m²], vx and vy [s²/m²], γ [1/rad²], ω [s²/rad²].
    position: PositiveWeight
    speed: CostWeight
    yaw: PositiveWeight
    spin: CostWeight
    #: Weights of ax and ay [s⁴/m²], ω' [s⁴/rad²].
    acceleration: PositiveWeight
    angular_acceleration: PositiveWeight

    @property
    def errors(self) -> Float[np.ndarray, " 6"]:
        """Weights of x, y, γ and their rates."""
        pose, rates = [self.position, self.position, self.yaw], [self.speed, self.speed, self.spin]
        return np.array(pose + rates)

    @property
    def efforts(self) -> Float[np.ndarray, " 3"]:
        """Weights of the accelerations of x, y and γ."""
        return np.array([self.acceleration, self.acceleration, self.angular_acceleration])


#: Weights that `airpuck.tune` changes; those of the accelerations set the scale.
TUNED = ("weights.position", "weights.speed", "weights.yaw", "weights.spin")


class LQRSettings(LawSettings):
    """Settings of the linear-quadratic regulator, and of its thrust allocation."""

    law = "lqr"
    tuned = TUNED

    weights: Weights
    #: Solver of the thrust allocation.
    solver: Literal["daqp", "piqp"] = "daqp"
    #: μ: cost of scaling a request down in the thrust allocation, relative to thrust.
    slack_weight: Annotated[float, pydantic.Field(gt=0, le=1e10)] = 1e6

    def slowed(self, times: float) -> Self:
        """Slow down the poles; see `LawSettings.slowed`."""
        powers = {"speed": 2, "spin": 2, "acceleration": 4, "angular_acceleration": 4}
        return self.model_copy(update={"weights": scaled(self.weights, powers, times)})


def point_mass(period: float) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 3"]]:
    """Discretise the craft as a point mass driven by accelerations (eq. point_mass_subsystem)."""
    a, b = np.eye(6), np.zeros((6, 3))
    a[:3, 3:] = b[3:] = period * np.eye(3)
    b[:3] = period**2 / 2 * np.eye(3)
    return a, b


def motor_lag(time_constant: Any, period: float) -> tuple[Any, Any]:
    """Discretise motors (eq. dis_motor_dynamics): their next speeds are A φ + B u."""
    decay = lag_decay(np, period, np.squeeze(time_constant))
    return decay, 1 - decay


def rotation_error(
    spin: Float[np.ndarray, "*shape"], period: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape"]:
    """Quantify the error of the discretisation: the craft turns while the force is held.

    The discretisation applies R(γ_k) F for a whole period, but the force turns with the craft. The
    velocity gained is |∫ R(γ_k + ω t) F dt| = h F e^{iθ/2} sinc(θ/2), θ = ωh, instead of h F.
    """
    half = spin * period / 2
    return np.abs(np.exp(1j * half) * np.sinc(half / np.pi) - 1)


def lqr(
    a: Float[np.ndarray, "n n"],
    b: Float[np.ndarray, "n m"],
    q: Float[np.ndarray, "n n"],
    r: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "m n"]:
    """Solve the infinite-horizon discrete-time regulator problem.

    u = -K x minimises Σ xᵀQx + uᵀRu over x⁺ = A x + B u; K = (R + BᵀPB)⁻¹BᵀPA with P from the
    discrete algebraic Riccati equation.
    """
    p = cost_to_go(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


def cost_to_go(
    a: Float[np.ndarray, "n n"],
    b: Float[np.ndarray, "n m"],
    q: Float[np.ndarray, "n n"],
    r: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "n n"]:
    """Return P of xᵀPx, the cost of the regulator from x to zero."""
    from scipy.linalg import LinAlgError, solve_discrete_are

    try:
        return solve_discrete_are(a, b, q, r)
    except (LinAlgError, ValueError) as error:
        raise InputError(
            "no regulator with these weights is stable; use positive weights for position and yaw, "
            "and weights that differ less",
            field="weights",
        ) from error


def lqr_gain(weights: Weights, period: float) -> Float[np.ndarray, "3 6"]:
    """Compute the gain of the point mass.

    Parameters
    ----------
    weights : Weights
        Weights of errors and accelerations.
    period : float
        Sample time [s].

    Returns
    -------
    array, shape (3, 6)
        K of v = -K x, for the state x, y, γ, vx, vy, ω.

    Raises
    ------
    InputError
        If the weights give no stabilising regulator.
    """
    return lqr(*point_mass(period), np.diag(weights.errors), np.diag(weights.efforts))


class LQR(Law):
    """A quadratic regulator for the accelerations, and a thrust allocation that produces them.

    It predicts the state one period ahead with the accelerations already determined by the motors.
    It requests v_{k+1} = a_ref - K (x_{k+1} - x_ref), with the shorter way round for the yaw error,
    subtracts the disturbance, and computes the commands that produce the result (eq. force_qp).

    Parameters
    ----------
    model : Model
        The craft; its thrust curves must rise.
    tuning : Tuning
        Period, and `LQRSettings`.
    options : LawOptions, optional
        Options, including the gain K for the state x, y, γ, vx, vy, ω.

    Raises
    ------
    InputError
        If a thrust curve falls somewhere.

    Examples
    --------
    >>> law = airpuck.LQR(model, airpuck.default_tuning())
    >>> controller = airpuck.TrackingController(model, airpuck.SetPoint(0.1, 0.0, 0.0), law=law)
    """

    SHOWN, Settings = "title gain", LQRSettings
    title, c_modules = "a linear regulator", ()
    looks_ahead = False

    def __init__(self, model: Model, tuning: Tuning, options: LawOptions | None = None) -> None:
        options = options or LawOptions()
        InverseThrust(model.dynamics.thrust)  # Raises InputError for curves that fall.
        n, period, settings = model.vehicle.n_propellers, tuning.period_s, tuning.of(LQRSettings)
        slack_weight = settings.slack_weight
        #: May be replaced at any time.
        self.gain = lqr_gain(settings.weights, period) if options.gain is None else options.gain
        self.stage = plan_stage(model, period, slack_weight, options.reject_disturbance)
        self.inputs = np.zeros(6), np.zeros(3), self.gain
        self._period, self._idle = period, np.full(n, model.vehicle.command_min)
        allocated = n, model.radius_of_gyration, slack_weight, settings.solver
        self._allocator = ThrustAllocator(*allocated)
        command, motors, bounds = command_stage(model, period), np.zeros(n), np.zeros(n + 5)
        given = np.zeros(n + 2), bounds, bounds, motors
        self._command = program(command, *given, compiled=options.compiled)

    def step(self, state: Any, moment: Moment) -> tuple[Step, Any]:
        """Allocate thrusts for the accelerations that lead to the target; see `Law.step`."""
        # The target applies one period after the command begins to act.
        target = moment.reference.at(moment.now, moment.delay + self._period)
        estimate, results = moment.foresee(target.state, target.acceleration, self.gain)
        plan = AllocationProblem(*results)
        solution, outcome = self._allocator.solve(plan.a, plan.lower, plan.upper, plan.finite)
        if solution is not None:
            (command,) = self._command(solution, plan.lower, plan.upper, plan.coasting)
            if all_finite(command):
                return Step(command, outcome, plan.request, estimate), state
        return Step(self._idle.copy(), "failed", plan.request, estimate), state


class AllocationProblem(NamedTuple):
    """Inputs of the thrust allocation of one control step."""

    #: Requested acceleration [m/s², m/s², rad/s²].
    request: Num[Any, " 3"]
    #: Motor speeds one period later without a command.
    coasting: Num[Any, " n"]
    #: The quadratic program; see `airpuck.control.allocation.problem`.
    a: Num[Any, "3 m"]
    lower: Num[Any, " m+3"]
    upper: Num[Any, " m+3"]
    finite: Any


def plan_stage(
    model: Model, period: float, slack_weight: float, reject_disturbance: bool
) -> Callable[..., AllocationProblem]:
    """Return prediction, law and allocation program as one function.

    (xp, state, motor speeds, disturbance, effectiveness, target state, target acceleration, gain)
    → plan.
    """
    least, most = model.vehicle.command_min, model.vehicle.command_max
    known = model.dynamics, model.radius_of_gyration, motor_lag(model.dynamics.lag, period)

    def plan(
        xp: Any,
        known: Any,
        state: Num[Any, " 6"],
        speed: Num[Any, " n"],
        disturbance: Num[Any, " 3"],
        effectiveness: Num[Any, " n"],
        target: Num[Any, " 6"],
        feedforward: Num[Any, " 3"],
        gain: Num[Any, "3 6"],
    ) -> AllocationProblem:
        dynamics, arm, (lag, drive) = known
        # A motor that seems weak gets less weight; nothing is divided by its effectiveness.
        effectiveness = xp.clip(effectiveness, *_EFFECTIVENESS)
        believed = state, speed, disturbance, effectiveness
        following, matrix, offset = look_ahead(xp, dynamics, period, *believed)
        request = feedforward - gain @ pose_difference(xp, following, target)
        request = request - reject_disturbance * disturbance
        coasting = lag * speed
        low = thrust(dynamics.thrust, coasting + drive * least)
        high = thrust(dynamics.thrust, coasting + drive * most)
        posed = problem(xp, arm, slack_weight, request, matrix, offset, low, high)
        return AllocationProblem(request, coasting, *posed)

    return Applied(plan, known)


def look_ahead(
    xp: Any,
    dynamics: Dynamics,
    period: float,
    state: Num[Any, " 6"],
    speed: Num[Any, " n"],
    disturbance: Num[Any, " 3"],
    effectiveness: Num[Any, " n"],
) -> tuple[Num[Any, " 6"], Num[Any, "3 n"], Num[Any, " 3"]]:
    """Return the state one period later, and the map M F + g from thrusts to accelerations there.

    Until then the accelerations are fixed: they follow from the present motor speeds.
    """
    a, b = point_mass(period)
    matrix, offset = acceleration_map(xp, dynamics, state[2], state[5])
    settled = matrix * effectiveness @ thrust(dynamics.thrust, speed) + offset + disturbance
    following = a @ state + b @ settled
    matrix, offset = acceleration_map(xp, dynamics, following[2], following[5])
    return following, matrix * effectiveness, offset


def command_stage(model: Model, period: float) -> Callable[..., tuple[Any]]:
    """Return the inverse of thrust curves and motor lag, u = B⁻¹ (F⁻¹(F) - A φ) (seq:control).

    (xp, solution, lower, upper, coasting), as in `AllocationProblem` → commands.
    """
    vehicle, n = model.vehicle, model.vehicle.n_propellers
    least, most = vehicle.command_min, vehicle.command_max
    known = model.dynamics.thrust, motor_lag(model.dynamics.lag, period)[1]

    def command(
        xp: Any, known: Any, solution: Any, lower: Any, upper: Any, coasting: Any
    ) -> tuple[Any]:
        curves, drive = known
        # Solvers satisfy bounds to their tolerance; the result satisfies them exactly.
        speed = inverse_thrust(xp, curves, xp.clip(solution[:n], lower[:n], upper[:n]))
        return (xp.clip((speed - coasting) / drive, least, most),)

    return Applied(command, known)
