function rates = airpuck_acceleration(motion, speed, p)
% Acceleration of the geometric centre, in the world frame, and angular acceleration.
%
%   motion  yaw [rad], vx, vy [m/s], yaw rate [rad/s]
%   speed   motor speeds in [0, 1]
%   p       parameters; see airpuck_parameters
    c = cos(motion(1));
    s = sin(motion(1));
    spin = motion(4);
    felt = [c * motion(2) + s * motion(3); c * motion(3) - s * motion(2); spin];

    force = zeros(size(speed));
    for power = size(p.thrust, 2):-1:1
        force = (force + p.thrust(:, power)) .* speed;
    end
    % Each propeller loses thrust in its own inflow, in its twin's jet, and as the voltage drops.
    force = force .* (1 - p.inflow * (p.inflow_axes * felt));
    newtons = p.newtons .* force;
    paired = p.twin > 0;
    force(paired) = force(paired) ./ (1 + p.pair_interaction * newtons(p.twin(paired)));
    total = sum(p.newtons .* force);
    force = force * (2 / (1 + sqrt(1 + 4 * p.voltage_sag * total))) ^ 2;

    body = p.configuration * force;
    % Smooth at rest, where the speed has no derivative.
    velocity = sqrt(felt(1) ^ 2 + felt(2) ^ 2 + 1e-12);
    body(1:2) = body(1:2) - (p.drag(1) + p.drag(2) * velocity) * felt(1:2);
    body(3) = body(3) - (p.drag(3) + p.drag(4) * abs(spin)) * spin;

    % From the centre of mass to the geometric centre.
    r = p.center_of_mass;
    if p.center_of_mass_turns
        r = [c, -s; s, c] * r;
    end
    rates = [c * body(1) - s * body(2) + r(2) * body(3) + r(1) * spin ^ 2 + p.slope(1)
             s * body(1) + c * body(2) - r(1) * body(3) + r(2) * spin ^ 2 + p.slope(2)
             body(3)];
end
