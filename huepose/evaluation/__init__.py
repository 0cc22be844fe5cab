"""`huepose eval`: metrics, protocols and reports, also on a user's own data. Where to look:

    figures     metrics, bop_errors (pure functions on errors); summary (of rows, as text); states (of a
                track); calibration (of quality); bootstrap (intervals)
    labels      targets (reference model and error of a label), instances (assigns poses and tracks to labels)
    protocols   estimate_protocol > estimate_rows, perception_protocol > perception_rows,
                track_protocol (with sources) > track_rows, poses_protocol (of a live pipeline) > track_rows
    ablations   ablation > ablation_rows; paper_tracker
    an object   suitability; turned (its wrong rotations in words)
    results     result_files (written), measured > comparison (read back), pose_files (poses made elsewhere)
    output      pictures, results_page, tables (the paper's, from journals)
    speed       benches

Each protocol gives rows. The row modules make their summary and their file form.
"""
