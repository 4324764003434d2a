"""Prepare a study, once and in one order, for checks, calibration and further trials.

| step | module |
|---|---|
| the steps in their order, and their result: a `PreprocessedStudy` | `preprocessed_study` |
| remove outliers, isolated jumps and frames without the pelvis | `clean_trial` |
| reconstruct markers that the static trial lost | `rebuilt_markers` |
| make the nominal model; place a trunk that only walks show | `study_model` |
| find swapped labels; put them back | `swapped_labels`; `put_back_labels` |
| place clusters that were knocked since the static trial | `knocked_clusters` |
| compare a trial with the static posture: a `TrialEvidence` | `trial_evidence` |
| fit its clusters of markers | `marker_clusters` |
| relate the segments at its joints | `joint_links` |
| find contradictions to the static trial | `static_disagreement` |
| find displaced markers; find feet on plates | `displaced_markers`; `plate_contacts` |
"""
