"""The multi-legged chain's tables beside its theory.

`gait_shares.py`: fractions of gaits and conditions of existence; `travelling_wave.py`: lags, wavelength and
speed of waves, where their sources settle, and their drift.
"""
