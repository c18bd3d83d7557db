% The carrier model's right-hand side in Octave, thesis flavour, integrated with ode45.
%
%     octave --no-gui --quiet host/benches/reference/carrier_octave.m [seconds]
%
% Prints the speed after `seconds` of full drive from rest and what it cost; see docs/model.md.
1;

function dx = rhs(t, x, p)
  w1 = x(1); w2 = x(2); z = x(5); speed = x(8);
  travelling = sqrt(w1 ^ 2 + w2 ^ 2);
  amplitude = max(travelling, p.Wmin);
  phi = acos(min(1, max(-1, z / (p.Rr * amplitude))));
  psi = min(acos(min(1, max(-1, p.R0 ^ 2 * speed / (p.h * p.k * p.Rr * amplitude * p.omega)))), phi);
  sx = sin(phi); cx = cos(phi); ss = sin(psi); cs = cos(psi);
  g1 = 2 * (psi - phi / 2 + ss * cs - sx * cx / 2 - cx * (2 * ss - sx));
  g2 = 2 * ss ^ 2 - sx ^ 2 - 2 * cx ^ 2 + 4 * cx * cs - 2;
  bx = sx - phi * cx; bs = ss - psi * cx;
  normal = -p.Rr ^ 2 * p.R0 * p.Cn * (phi - sx * cx);
  drag = p.u * p.h * p.n * p.Rr ^ 2 * p.Cn;
  fint = 2 * p.Rr * p.R0 * p.Cn * amplitude * bx;
  tint = 2 * p.u * p.Rr * p.R0 ^ 2 * p.Cn * travelling * (2 * bs - bx);
  f1 = p.eta * p.Vmax * cos(p.omega * t) + normal * w1 + drag * (w2 * g1 - w1 * g2);
  f2 = p.eta * p.Vmax * sin(p.omega * t) + normal * w2 - drag * (w1 * g1 + w2 * g2);
  dx = [x(3); x(4); (f1 - p.Ks * w1 - p.Cs * x(3)) / p.Ms; (f2 - p.Ks * w2 - p.Cs * x(4)) / p.Ms; ...
        x(6); (fint - p.Fext - p.Cz * x(6)) / p.Mr; speed; (tint - p.Tload - p.Ctheta * speed) / p.Jr];
end

p = struct("Vmax", 105 / 0.7071, "omega", 2 * pi * 45000, "Ms", 0.624, "Cs", 5469.328, "Ks", 4.798e10, "eta", 0.5439, ...
           "Rr", 0.7, "R0", 0.013675, "n", 6, "h", 0.00025, "Mr", 6.09e-3, "Jr", 765.58e-9, "Cz", 35, "Ctheta", 2e-7, ...
           "u", 0.1057, "Fext", 1, "Tload", 0, "Cn", 20761245675 / 3.33);
p.k = p.n / p.R0;
p.Wmin = p.Fext / (2 * p.Rr * p.R0 * p.Cn);
seconds = 0.001;
given = argv();
if numel(given) > 0
  seconds = str2double(given{end});
end
scale = [1e-8; 1e-8; 1e-3; 1e-3; 1e-8; 1e-3; 1e-3; 1];
options = odeset("RelTol", 1e-6, "AbsTol", 1e-6 * scale, "InitialStep", 1e-8);
began = cputime();
[t, x] = ode45(@(t, x) rhs(t, x, p), [0, seconds], zeros(8, 1), options);
spent = cputime() - began;
printf("ode45: %.5f rad/s, %d steps, %.3f s, %.0f s a simulated second\n", x(end, 8), numel(t), spent, spent / seconds);
