"""The linkage: segments, joints, parameters, marker sets, nominal models."""
