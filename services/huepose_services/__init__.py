"""The pipeline around the vision library: one worker process for each module with a `make(bus, config)`.

- Workers that poses need: `camera.ingest` (pictures in), `tracker`, `reinit` (what to look at, what to take
  over), and perception: `detector`, `segmenter`, `estimator`. `runtime.worker` runs one, `runtime.supervisor`
  all.
- Workers that look at poses, or pass them on: `gateway` (with `gateway_session` and `gateway_door`),
  `viewer`, `ros2`; between two computers `uplink` and `downlink` (with `link`).
- What several of them use: `convert` (between the wire and the library), `models` and `builtin` (reference
  models), `following` (the list of objects), `steering` (who changes it), `boxes`, `networks` and
  `catalogue`, `pem` (certificates).
- Why a pose is not to be acted on: `doubts`, `camera_doubts`, `delay_doubt`; `first_frame`, that none came.
- What is recorded of the tracker: `intake`, `held`; `recording` writes, plays and verifies it.
- Commands: `cli`, with `demo`, `doctor`, `chaos` (faults), `watch` (status), `authority` (certificates),
  `bus_bench`; `first_time` is what `make setup` runs.
"""
