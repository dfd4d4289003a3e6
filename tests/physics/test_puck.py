"""A puck's motion and bounces, against closed forms, integration and a contact simulator."""

import math

import numpy as np
import pymunk
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from airpuck.craft.table import Contact, Puck, Table
from airpuck.physics.puck import (
    Disc,
    PlainNumbers,
    PuckState,
    Walls,
    coast,
    contact_impulse,
    mobility,
    sigma_of,
    sigma_to_circle,
    strike,
    time_of,
)

RADIUS = Puck().radius_m
TABLE = Table(length_m=2.0, width_m=1.0, goal_width_m=0.4)
WALLS = Walls(TABLE, RADIUS)
share = st.floats(0, 1)
speed = st.floats(-10, 10)
laws = st.builds(Contact, restitution=share, grip=share, friction=st.floats(0, 1.5))


def disc(x=0.0, y=0.0, vx=0.0, vy=0.0, spin=0.0, radius=RADIUS, mass=0.01):
    return Disc(x, y, vx, vy, spin, radius, mass, mass * radius**2 / 2)


def energy(*discs):
    return sum(
        d.mass / 2 * (d.vx**2 + d.vy**2) + d.inertia / 2 * d.spin**2
        for d in discs
        if math.isfinite(d.mass)
    )


def test_a_coasting_puck_solves_its_differential_equation():
    puck = Puck(drag_1_s=0.3, spin_drag_1_s=0.7)
    start = PuckState(0.1, -0.2, 3.0, 2.0, -1.0, 20.0)
    rate = np.array([0.3, 0.3, 0.7])
    solved = solve_ivp(
        lambda _, z: np.concatenate([z[3:], -rate * z[3:]]), (0, 2), start, rtol=1e-11, atol=1e-12
    )
    np.testing.assert_allclose(coast(puck, start, 2.0), solved.y[:, -1], rtol=1e-9)


def test_without_drag_a_puck_moves_straight_at_constant_speed():
    puck = Puck(drag_1_s=0.0, spin_drag_1_s=0.0)
    assert coast(puck, PuckState(1.0, 2.0, 0.0, 3.0, -4.0, 5.0), 2.0) == (7, -6, 10, 3, -4, 5)


@given(st.floats(0, 2), st.floats(1e-6, 5))
def test_sigma_and_time_are_inverse(drag, duration):
    assert time_of(drag, sigma_of(drag, duration)) == pytest.approx(duration, rel=1e-9)


def test_a_puck_that_stops_first_never_arrives():
    # It stops after v / k = 5 m.
    assert time_of(0.2, 5.0 / 1.0) == math.inf
    assert time_of(0.2, 4.999) < math.inf


@given(*[st.floats(-3, 3)] * 4, st.floats(0.01, 0.5))
def test_the_first_intersection_with_a_circle_is_found(x, y, vx, vy, radius):
    sigma = sigma_to_circle(x, y, vx, vy, radius)
    dense = np.linspace(0, 5, 2001)
    distance = np.hypot(x + vx * dense, y + vy * dense)
    if math.hypot(x, y) <= radius:
        assert sigma in (0.0, math.inf)
    elif sigma < math.inf:
        assert math.hypot(x + vx * sigma, y + vy * sigma) == pytest.approx(radius, rel=1e-7)
        assert (distance[dense < sigma] > radius * (1 - 1e-9)).all()
    else:
        assert (distance > radius * (1 - 1e-9)).all()


@pytest.mark.parametrize(
    ("start", "sigma", "boundary", "normal"),
    [
        # The centre of the puck gets within a radius of a rail.
        ((0.0, 0.3, 0, 1.0, 0.0), 1.0 - RADIUS, "rail", (-1, 0)),
        ((0.0, 0.3, 0, -2.0, 0.0), (1.0 - RADIUS) / 2, "rail", (1, 0)),
        ((0.0, 0.0, 0, 0.0, 1.0), 0.5 - RADIUS, "rail", (0, -1)),
        ((0.0, 0.0, 0, 0.0, -1.0), 0.5 - RADIUS, "rail", (0, 1)),
        # All of the puck must be behind the line.
        ((0.0, 0.1, 0, 1.0, 0.0), 1.0 + RADIUS, "goal", (0, 0)),
        ((0.0, -0.16, 0, -1.0, 0.0), 1.0 + RADIUS, "goal", (0, 0)),
        # Half a radius beside the post: the normal is at 30° to the rail.
        (
            (0.0, 0.2 - RADIUS / 2, 0, 1.0, 0.0),
            1.0 - RADIUS * math.cos(math.pi / 6),
            "post",
            (-math.cos(math.pi / 6), -0.5),
        ),
        # Behind the line, the sides of the goal.
        ((1.01, 0.0, 0, 0.0, 1.0), 0.2 - RADIUS, "post", (0, -1)),
        # From between the posts, back to the table.
        ((0.99, 0.0, 0, -1.0, 0.0), 1.99 + RADIUS, "goal", (0, 0)),
    ],
)
def test_the_first_contact_of_a_puck_is_found(start, sigma, boundary, normal):
    found = WALLS.first(PuckState(*start))
    assert found.sigma == pytest.approx(sigma, rel=1e-12)
    assert found.boundary == boundary
    assert (found.nx, found.ny) == pytest.approx(normal, abs=1e-12)


def test_a_puck_at_rest_meets_nothing():
    assert WALLS.first(PuckState(0.3, 0.2)).sigma == math.inf


@given(st.floats(-1.1, 1.1), st.floats(-0.6, 0.6))
def test_the_nearest_free_place_is_found_and_kept(x, y):
    near = WALLS.nearest(x, y)
    line, half = TABLE.length_m / 2, TABLE.goal_width_m / 2
    assert abs(near[1]) <= TABLE.width_m / 2 - RADIUS + 1e-12
    if abs(near[1]) >= half:
        assert abs(near[0]) <= line - RADIUS + 1e-12
    for post in (-half, half):
        assert math.hypot(abs(near[0]) - line, near[1] - post) >= RADIUS - 1e-12
    assert WALLS.nearest(*near) == pytest.approx(near, abs=1e-12)


@pytest.mark.parametrize("angle", [0.1, 0.7, 1.2])
def test_a_smooth_elastic_rail_acts_as_a_mirror(angle):
    body = disc(vx=math.cos(angle), vy=-math.sin(angle), spin=5.0)
    strike(body, Disc(0.0, 0.0), 0.0, 1.0, Contact(restitution=1.0, grip=0.0))
    expected = math.cos(angle), math.sin(angle), 5.0
    assert (body.vx, body.vy, body.spin) == pytest.approx(expected)


def test_the_published_rail_keeps_its_stated_shares_of_speed():
    # It keeps 0.79 of its speed across the rail and 0.84 along it; the lost momentum turns it.
    body = disc(vx=1.0, vy=-2.0)
    strike(body, Disc(0.0, 0.0), 0.0, 1.0, Puck().rail)
    assert body.vy == pytest.approx(0.79 * 2.0)
    assert body.vx == pytest.approx(0.84)
    # I ω = m r Δv: ω = 2 · 0.16 / r, so that the lower side moves on along the rail.
    assert body.spin == pytest.approx(-2 * 0.16 / RADIUS)


def test_a_grazing_puck_slips_within_the_friction_cone():
    body = disc(vx=5.0, vy=-0.1)
    strike(body, Disc(0.0, 0.0), 0.0, 1.0, Contact(restitution=0.5, grip=1.0, friction=0.2))
    assert body.vx == pytest.approx(5.0 - 0.2 * 1.5 * 0.1)


def test_equal_elastic_discs_exchange_their_speeds():
    first, second = disc(vx=-1.5), disc(x=-2 * RADIUS, vx=0.5)
    strike(first, second, 1.0, 0.0, Contact(restitution=1.0))
    assert (first.vx, second.vx) == pytest.approx((0.5, -1.5))


def test_a_mallet_acts_as_a_moving_rail():
    # In its own frame the disc is a rail: v' = w + e (w - v).
    body = disc(vx=-2.0)
    strike(body, Disc(0.0, 0.0, vx=3.0, radius=0.05), 1.0, 0.0, Contact(restitution=0.8))
    assert body.vx == pytest.approx(3.0 + 0.8 * 5.0)


motions = st.tuples(speed, speed, st.floats(-50, 50))


@given(motions, motions, st.floats(-math.pi, math.pi), laws, st.floats(0.005, 0.5), share)
def test_momentum_and_angular_momentum_are_conserved_and_energy_never_grows(
    one, other, angle, law, mass, offset
):
    nx, ny = math.cos(angle), math.sin(angle)
    first = disc(0.3, 0.1, *one)
    second = disc(0.3 - 0.1 * nx, 0.1 - 0.1 * ny, *other, radius=0.1 - RADIUS, mass=mass)
    # Kane and Levinson: with an offset, Newton's law needs a check of the energy.
    second.offset = (offset * 3e-3, -offset * 2e-3)
    if (first.vx - second.vx) * nx + (first.vy - second.vy) * ny >= 0:
        first.vx, second.vx = second.vx, first.vx
        first.vy, second.vy = second.vy, first.vy

    def centre(d):
        rx, ry = d.offset
        return d.x + rx, d.y + ry, d.vx - d.spin * ry, d.vy + d.spin * rx

    def sums():
        px = py = spin = kinetic = 0.0
        for d in (first, second):
            x, y, vx, vy = centre(d)
            px, py = px + d.mass * vx, py + d.mass * vy
            spin += d.inertia * d.spin + d.mass * (x * vy - y * vx)
            kinetic += d.mass / 2 * (vx**2 + vy**2) + d.inertia / 2 * d.spin**2
        return px, py, spin, kinetic

    before = sums()
    strike(first, second, nx, ny, law)
    after = sums()
    assert after[:3] == pytest.approx(before[:3], rel=1e-9, abs=1e-9)
    assert after[3] <= before[3] * (1 + 1e-12) + 1e-15


def bounced(first, second, law, normal):
    """Collide two discs in pymunk; a second disc of infinite mass becomes a wall segment."""
    space = pymunk.Space()
    space.iterations = 50
    bodies = []
    for d in (first, second):
        fixed = math.isinf(d.mass)
        body = space.static_body if fixed else pymunk.Body(d.mass, d.inertia)
        if fixed:
            (nx, ny), far = normal, 10.0
            ends = (d.x - far * ny, d.y + far * nx), (d.x + far * ny, d.y - far * nx)
            shape = pymunk.Segment(body, *ends, 0.0)
        else:
            body.position, body.velocity, body.angular_velocity = (d.x, d.y), (d.vx, d.vy), d.spin
            shape = pymunk.Circle(body, d.radius)
            space.add(body)
        # pymunk multiplies the coefficients of both shapes.
        shape.elasticity, shape.friction = math.sqrt(law.restitution), math.sqrt(law.friction)
        space.add(shape)
        bodies.append(body)
    for _ in range(200):
        space.step(1e-6)
    return bodies


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("walled", [False, True])
def test_bounces_agree_with_pymunk(seed, walled):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi)
    nx, ny = math.cos(angle), math.sin(angle)
    # pymunk's friction takes all slip that the cone allows.
    law = Contact(restitution=rng.uniform(0, 1), grip=1.0, friction=rng.uniform(0, 1))
    first = disc(0.2, 0.1, *rng.uniform(-3, 3, 2).tolist(), rng.uniform(-30, 30))
    if walled:
        second = Disc(0.2 - RADIUS * nx, 0.1 - RADIUS * ny)
    else:
        apart = RADIUS + 0.07
        motion = *rng.uniform(-3, 3, 2).tolist(), rng.uniform(-30, 30)
        second = disc(0.2 - apart * nx, 0.1 - apart * ny, *motion, radius=0.07, mass=0.14)
    closing = -((first.vx - second.vx) * nx + (first.vy - second.vy) * ny)
    if closing < 0:
        first.vx, first.vy = first.vx + 2 * closing * nx, first.vy + 2 * closing * ny
    # Start a micrometre before the contact, so that pymunk detects it.
    first.x, first.y = first.x + 1e-6 * nx, first.y + 1e-6 * ny
    theirs = bounced(first, second, law, (nx, ny))
    strike(first, second, nx, ny, law)
    for ours, their in zip((first, second), theirs, strict=True):
        if math.isfinite(ours.mass):
            assert (ours.vx, ours.vy) == pytest.approx(tuple(their.velocity), abs=2e-3)
            assert ours.spin == pytest.approx(their.angular_velocity, abs=0.05)


speeds = st.floats(-5, 5)
arms = st.floats(-0.1, 0.1)
MASS, INERTIA = 0.14, 3e-4


@given(speeds, speeds, share, st.floats(0, 2), share, arms, arms)
def test_plain_numbers_and_arrays_agree(normal, slip, restitution, friction, grip, arm_n, arm_t):
    k = mobility(MASS, INERTIA, arm_n, arm_t)
    arrays = mobility(MASS, INERTIA, np.array([arm_n]), np.array([arm_t]))
    law = (restitution, friction, grip)
    plain = contact_impulse(PlainNumbers, k, normal, slip, *law)
    array = contact_impulse(np, arrays, np.array([normal]), np.array([slip]), *law)
    np.testing.assert_array_equal(plain, np.ravel(array))


@given(st.floats(-5, -0.01), speeds, share, st.floats(0, 2), share, arms)
def test_a_central_contact_rebounds_and_stays_in_the_friction_cone(
    normal, slip, restitution, friction, grip, arm_n
):
    k = mobility(MASS, INERTIA, arm_n, 0.0)
    n, t = contact_impulse(PlainNumbers, k, normal, slip, restitution, friction, grip)
    assert normal + k[0] * n == pytest.approx(-restitution * normal, abs=1e-12)
    assert n > 0
    assert abs(t) <= friction * n + 1e-15
    after = slip + k[1] * t
    assert abs(after) <= abs(slip) + 1e-12
    if abs(t) < friction * n * (1 - 1e-9):
        assert after == pytest.approx((1 - grip) * slip, abs=1e-12)


@given(st.floats(-5, 0), speeds, share, st.floats(0, 2), share, arms, arms)
def test_no_contact_adds_energy(normal, slip, restitution, friction, grip, arm_n, arm_t):
    k_nn, k_tt, k_nt = k = mobility(MASS, INERTIA, arm_n, arm_t)
    n, t = contact_impulse(PlainNumbers, k, normal, slip, restitution, friction, grip)
    work = n * (normal + (k_nn * n + k_nt * t) / 2) + t * (slip + (k_nt * n + k_tt * t) / 2)
    assert work <= 1e-12
