"""What can be told of a study before anything is solved: one small function a check, each giving findings."""

from gaitcal.checks.study import check_file, check_further, check_study

__all__ = ["check_file", "check_further", "check_study"]
