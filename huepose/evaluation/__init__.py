"""What `huepose eval` does: metrics, protocols and reports, also on a user's own data. Where to look:

    figures     metrics, bop_errors (pure functions on errors); summary (of rows, in text); states (of a
                track); calibration (of quality); bootstrap (intervals)
    labels      targets (whose model, which error), instances (poses and tracks to labels)
    protocols   estimate_protocol > estimate_rows, perception_protocol > perception_rows,
                track_protocol (with sources) > track_rows, poses_protocol (of a live pipeline) > track_rows
    ablations   ablation > ablation_rows; paper_tracker
    an object   suitability; turned (its turned answers in words)
    results     result_files (written), measured > comparison (read again), pose_files (of others)
    forms       pictures, results_page, tables (the paper's, from journals)
    speed       benches

Each protocol gives rows; rows know their summary and their file form.
"""
