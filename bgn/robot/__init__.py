"""Hardware in the loop: a UR5e with a two-finger gripper plays the force-feedback tasks, or its digital twin does.

Importing this package opens no socket and needs neither ``ur_rtde`` nor MuJoCo.
"""
