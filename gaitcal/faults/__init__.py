"""What is wrong with recordings: each fault found, undone or limited, and told; and the verdict that follows.

| family | file |
|---|---|
| labels and presence of markers; one marker alone on a segment | `markers` |
| exchanged labels, right and left | `exchanged` |
| markers that leave their place, slip, freeze; paths made up | `marker_slip` |
| frames, times, seams, single jumps, filters | `sampling` |
| does a trial show what its role says: upright, still, walking, one joint | `role` |
| landmarks of the static trial, against `model/body_plan` | `static_landmarks` |
| the line through the epicondyles | `knee_line` |
| one body in all trials: size; `cluster`, `joint_link`, and the cause: `contradiction` | `static_consistency` |
| clusters knocked since the static trial, placed by the rest | `knocked` |
| foot on plate | `foot_on_plate` |
| plates: signals, corners, signs, mass | `plates` |
| forces against motion: `plate_forces`, `force_evidence`, `force_causes`, `force_choice` | `force_diagnosis` |
| joints where nobody has them | `joint_places` |
| what a finished fit says | `after_fit` |
| what follows from what, and the verdict | `verdict` |

`study` runs the checks of trials, each a function of `evidence.MarkerEvidence` that yields findings.
"""
