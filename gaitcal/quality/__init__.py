"""Quality control: checks of recordings, forces and fits, their findings, and the verdict. Changes
no data.

| checks | module |
|---|---|
| labels and presence of markers; one marker alone on a segment | `marker_checks` |
| labels exchanged for a while, or right and left | `label_checks` |
| markers that leave their place, slip or freeze | `marker_slip` |
| frames, times, seams, single jumps, filters | `sampling` |
| does a trial show what its role says: upright, still, walking, one joint | `trial_role` |
| landmarks of the static trial, against `model/body_plan` | `static_landmarks` |
| the line through the epicondyles | `knee_axes` |
| one body in all trials | `static_consistency` |
| foot on plate | `foot_on_plate` |
| plates: signals, corners, signs, mass | `plate_checks` |
| forces against motion: `plate_forces`, `force_evidence`, `force_causes`, `force_choice` | `force_diagnosis` |
| joints where no person has them | `joint_positions` |
| a finished fit | `after_fit` |
| consequences of findings, and the verdict | `verdict` |

`study_checks` runs the checks of trials, each a function of a `TrialEvidence` that yields findings;
they read a `PreprocessedStudy`.
"""
