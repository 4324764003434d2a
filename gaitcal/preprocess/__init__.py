"""Prepare a study, once and in one order, for checks, calibration and further trials.

| step, and what it works on | module |
|---|---|
| the steps in their order, and what they give: a `PreprocessedStudy` | `preprocessed_study` |
| outliers, single positions out of line, frames without the pelvis | `clean_trial` |
| markers that the static trial lost | `rebuilt_markers` |
| the nominal model; a trunk that only walks show | `study_model` |
| exchanged labels: found; put back | `swapped_labels`; `put_back_labels` |
| clusters that were knocked since the static trial | `knocked_clusters` |
| what a trial shows, against the static posture: a `TrialEvidence` | `trial_evidence` |
| its clusters of markers, and its joints | `marker_clusters`, `joint_links` |
| what contradicts the static trial | `static_disagreement` |
| markers that leave their place; feet on plates | `displaced_markers`; `plate_contacts` |
"""
