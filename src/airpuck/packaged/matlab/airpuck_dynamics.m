function rate = airpuck_dynamics(state, command, p)
% Rate of the state under a command.
%
%   state    x, y [m], yaw [rad], vx, vy [m/s], yaw rate [rad/s], and the motor speeds if they lag
%   command  commands that reach the motors, in [0, 1]
%   p        parameters; by default those of airpuck_parameters
    if nargin < 3
        p = airpuck_parameters();
    end
    state = state(:);
    command = command(:);
    if p.motor_time_constant == 0
        rate = [state(4:6); airpuck_acceleration(state(3:6), command, p)];
        return
    end
    speed = state(7:end);
    lag = p.motor_time_constant * (1 + p.idle_lag * exp(-speed / p.idle_speed));
    rate = [state(4:6); airpuck_acceleration(state(3:6), speed, p); (command - speed) ./ lag];
end
