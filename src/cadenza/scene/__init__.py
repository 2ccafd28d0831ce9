"""The MuJoCo scene of a keyboard and hands: its model, servos, kinematics, cameras and drawing."""
