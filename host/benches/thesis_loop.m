% Speed from encoder samples the way section A.7 of the thesis goes about it: one polynomial fit a sample, in a loop.
% Usage: octave-cli thesis_loop.m FILE, where FILE holds one 0 or 1 a line, 1 ms apart. Prints seconds a record.
bits = load(argv(){1});
period = 1e-3;
step = round(2 * pi / 400 * 1e5) / 1e5;
half = 10;

function speed = raw_speed(bits, period, step, half)
  n = numel(bits);
  position = zeros(n, 1);
  for k = 2:n
    position(k) = position(k - 1) + step * (bits(k) ~= bits(k - 1));
  end
  at = find(diff(position) > 0);
  event_time = [0; (at - 0.5) * period];
  event_position = [0; position(at) + step / 2];
  last = at(end) + 1;
  time = (0:last - 1)' * period;
  smooth = interp1(event_time, event_position, time, 'spline', 'extrap');
  speed = zeros(last - half, 1);
  for k = half + 1:last - half
    window = k - half:k + half;
    cubic = polyfit(time(window), smooth(window), 3);
    fitted = polyval(cubic, time(k));
    speed(k) = polyval(polyder(cubic), time(k)) * 30 / pi;
  end
  cubic = polyfit(time(1:half), smooth(1:half), 3);
  for k = 1:half
    fitted = max(polyval(cubic, time(k)), 0);
    speed(k) = max(polyval(polyder(cubic), time(k)) * 30 / pi, 0);
  end
end

best = Inf;
for repeat = 1:3
  tic;
  speed = raw_speed(bits, period, step, half);
  best = min(best, toc);
end
warning('off', 'all');
printf('%.9g %.9g\n', best, mean(speed));
