"""Small models, written as by a user, each with a job.

`hopper` is the smallest hybrid model, `ring_hopper` has coupled oscillators, `bouncing_ball` a moving table;
`slip_runner` and `spring_mass_walker` are spring-legged, `compass_walker` and `rimless_wheel` passive
walkers, the wheel also on rough ground. `four_legs` is a quadruped; `boom_walker` and `mujoco_hopper` have a
body of an MJCF, and the model files in `walkers` need no Python. `henon` is a map, `lorenz` and `duffing` are
flows. `package_of_a_model` and `package_of_a_paper` are templates of packages.
"""
