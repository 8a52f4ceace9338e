function depth = depth_hold(host, port, wanted)
% DEPTH_HOLD  Hold a depth over TCP with JSON lines, in MATLAB (R2021a or later) or GNU Octave 7 with the package instrument-control.
%
%   uwserver run bluerov2_pool --paused
%   depth = depth_hold("127.0.0.1", 7600, 2.0)
%
% The world is stepped by this function: 12 ticks of 240 Hz between two commands.
  if exist("OCTAVE_VERSION", "builtin")
    pkg("load", "instrument-control");
  end
  server.link = tcpclient(host, port);
  server.buffer = "";
  server.sample = [];
  server.id = 0;
  period = 12 / 240;
  rate = 0; total = 0; before = NaN; depth = NaN;
  server = ask(server, "subscribe", struct("pattern", "bluerov2/depth", "delivery", "latest"));
  for k = 1:600
    server = ask(server, "step", struct("n", 12));
    if isempty(server.sample)
      continue
    end
    depth = server.sample.value.depth;
    if ~isnan(before)
      rate = rate + 0.3 * ((depth - before) / period - rate);
    end
    before = depth;
    err = min(max(wanted - depth, -0.5), 0.5);
    total = min(max(total + err * period, -1), 1);
    u = min(max(0.6 * err + 0.15 * total - 0.7 * rate, -1), 1);
    value = struct("u", [0 0 0 0 u u u u]);
    server = ask(server, "command", struct("port", "bluerov2/thrusters", "value", value));
  end
  fprintf("depth %.2f m\n", depth);
end

function server = ask(server, method, params)
% Send a request and wait for its reply; the newest sample that comes meanwhile is kept in server.sample.
  server.id = server.id + 1;
  request = struct("jsonrpc", "2.0", "id", server.id, "method", method, "params", params);
  write(server.link, uint8([jsonencode(request) char(10)]));
  while true
    [line, server] = next_line(server);
    message = jsondecode(line);
    if isfield(message, "method") && strcmp(message.method, "sample")
      server.sample = message.params;
    elseif isfield(message, "id") && isequal(message.id, server.id)
      if isfield(message, "error")
        error("uwserver:refused", "%s", message.error.message);
      end
      return
    end
  end
end

function [line, server] = next_line(server)
% One line from the server, without its end.
  while true
    place = find(server.buffer == char(10), 1);
    if ~isempty(place)
      line = server.buffer(1:place - 1);
      server.buffer = server.buffer(place + 1:end);
      return
    end
    count = server.link.NumBytesAvailable;
    if count > 0
      server.buffer = [server.buffer char(read(server.link, count))];
    else
      pause(0.0005);
    end
  end
end
