function [A, B, command] = airpuck_hover(yaw, p)
% Linearisation about hover: deviations follow z' = A z + B u.
%
%   yaw      orientation at rest [rad]; by default 0
%   p        parameters; by default those of airpuck_parameters
%   command  commands near half speed that keep the craft at rest
%
% Derivatives are complex steps, so they are exact to rounding.
    if nargin < 1
        yaw = 0;
    end
    if nargin < 2
        p = airpuck_parameters();
    end
    motion = [yaw; 0; 0; 0];
    command = p.hover;
    if p.effects
        % Start from the hover without effects, and correct it by Newton's method, with steps of
        % least norm.
        for pass = 1:10
            slope = slopes(@(u) airpuck_acceleration(motion, u, p), command);
            left = airpuck_acceleration(motion, command, p);
            command = min(max(command - pinv(slope) * left, 0), 1);
        end
    end
    state = [0; 0; yaw; 0; 0; 0];
    if p.motor_time_constant > 0
        state = [state; command];
    end
    A = slopes(@(z) airpuck_dynamics(z, command, p), state);
    B = slopes(@(u) airpuck_dynamics(state, u, p), command);
end

function slope = slopes(f, point)
    step = 1e-30;
    slope = zeros(numel(f(point)), numel(point));
    for k = 1:numel(point)
        moved = point;
        moved(k) = moved(k) + 1i * step;
        slope(:, k) = imag(f(moved)) / step;
    end
end
