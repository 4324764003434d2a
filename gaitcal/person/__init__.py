"""The main job: one person from a study to joint torques, and what to think of them."""
