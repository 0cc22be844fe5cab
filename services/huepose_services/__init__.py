"""The pipeline around the vision library: one worker process for each module with a `make(bus, config)`.

- Workers that produce poses: `camera.ingest` (publishes frames), `tracker`, `reinit` (decides what to search
  for and what to correct), and perception: `detector`, `segmenter`, `estimator`. `runtime.worker` runs one
  worker, `runtime.supervisor` runs all.
- Workers that show poses or pass them on: `gateway` (with `gateway_session` and `gateway_door`), `viewer`,
  `ros2`; between two computers `uplink` and `downlink` (with `link`).
- Modules that several of them use: `convert` (between the wire and the library), `models` and `builtin`
  (reference models), `following` (follows the list of objects), `steering` (changes the list),
  `objects_of_file` (changes it as pipeline.yaml says), `boxes`, `networks` and `catalogue`, `pem`
  (certificates).
- Why a robot must not act on a pose: `doubts`, `camera_doubts`, `delay_doubt`. `first_frame` warns that no
  frame has come.
- What is recorded of the tracker: `intake`, `held`; `recording` writes, plays and verifies it.
- Commands: `cli`, with `demo`, `doctor`, `chaos` (faults), `watch` (status), `authority` (certificates),
  `bus_bench`; `first_time` is what `make setup` runs.
"""
