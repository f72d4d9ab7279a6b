"""Coupons: stress-stretch tests as one material point, diagnosed with the same verdicts as a body."""
