"""The published study, table by table: synthetic truth, recovered parameters, ours beside the printed figures."""
