function state = airpuck_step(state, command, period, p)
% State after a command that is held for a period [s]; arguments as for airpuck_dynamics.
%
% One fourth-order Runge-Kutta step; motors with a constant lag are exact.
    if nargin < 4
        p = airpuck_parameters();
    end
    state = state(:);
    command = command(:);
    h = period;
    if p.motor_time_constant > 0
        begins = state(7:end);
    else
        begins = command;
    end
    middle = motors(begins, command, h / 2, p);
    ends = motors(begins, command, h, p);

    motion = state(1:6);
    k1 = rates(motion, begins, p);
    k2 = rates(motion + h / 2 * k1, middle, p);
    k3 = rates(motion + h / 2 * k2, middle, p);
    k4 = rates(motion + h * k3, ends, p);
    state(1:6) = motion + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    if p.motor_time_constant > 0
        state(7:end) = ends;
    end
end

function rate = rates(motion, speed, p)
    rate = [motion(4:6); airpuck_acceleration(motion(3:6), speed, p)];
end

function speed = motors(speed, command, duration, p)
    tau = p.motor_time_constant;
    if tau == 0
        speed = command;
        return
    end
    % A lag that depends on the speed is taken in the middle of the step.
    lag = tau * (1 + p.idle_lag * exp(-speed / p.idle_speed));
    halfway = command + (speed - command) .* exp(-duration / 2 ./ lag);
    lag = tau * (1 + p.idle_lag * exp(-halfway / p.idle_speed));
    speed = command + (speed - command) .* exp(-duration ./ lag);
end
