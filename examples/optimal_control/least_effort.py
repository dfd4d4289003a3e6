"""Fly 0.5 m sideways and turn by 90° in 1 s with the least effort, by CasADi alone."""

import sys

import casadi

dynamics = casadi.Function.load(sys.argv[1] + "/discrete.casadi")
n, motors, period, u_min = 40, 6, 0.025, 0.03
problem = casadi.Opti()
state, command = problem.variable(6 + motors, n + 1), problem.variable(motors, n)
problem.minimize(casadi.sumsqr(command))
problem.subject_to(state[:, 1:] == dynamics.map(n)(state[:, :-1], command, period))
problem.subject_to(problem.bounded(u_min, command, 1))
problem.subject_to(state[:, 0] == casadi.vertcat(casadi.DM.zeros(6), [u_min] * motors))
problem.subject_to(state[:6, -1] == casadi.vertcat(0, 0.5, casadi.pi / 2, 0, 0, 0))
problem.set_initial(command, 0.3)
problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
solved = problem.solve()
print("mean squared command:", solved.value(casadi.sumsqr(command)) / command.numel())
print("final state:", solved.value(state[:6, -1]))
