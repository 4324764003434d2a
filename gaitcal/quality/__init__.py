"""Quality control: checks of recordings, forces and fits, their findings, and the verdict.

Checks change no data.

| checks | module |
|---|---|
| labels and presence of markers; segments with a single marker | `marker_checks` |
| swapped labels, for a while or by sides | `label_checks` |
| displaced, slipping and frozen markers | `marker_slip` |
| frames, times, seams, single jumps, filters | `sampling` |
| role of a trial: upright, still, walking, a single joint | `trial_role` |
| landmarks of the static trial, by `model/body_plan` | `static_landmarks` |
| computed joint centres with the labels of markers | `named_joint_centres` |
| epicondyle lines | `knee_axes` |
| one body in all trials | `static_consistency` |
| feet on plates | `foot_on_plate` |
| plates: signals, corners, signs, mass | `plate_checks` |
| forces: `plate_forces`, `force_evidence`, `force_causes`, `force_choice` | `force_diagnosis` |
| unusual joint positions | `joint_positions` |
| a finished fit | `after_fit` |
| consequences of findings, and the verdict | `verdict` |

`study_checks` runs the checks of trials. Each is a function of a `TrialEvidence` that yields
findings; a study is read as a `PreprocessedStudy`.
"""
