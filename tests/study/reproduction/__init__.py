"""Tests of the reproduction of the published study."""
