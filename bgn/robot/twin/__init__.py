"""A digital twin of the laboratory: a simulated UR5e controller and gripper with MuJoCo behind them.

It runs in a process of its own and listens on loopback addresses only.
"""
