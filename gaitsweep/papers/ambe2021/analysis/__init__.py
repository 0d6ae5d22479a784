"""The multi-legged chain's tables beside its theory.

`gait_shares.py`: fractions of gaits and conditions of existence; `source_place.py`: where sources settle, and
their drift; `travelling_wave.py`: lags, wavelength and speed.
"""
