"""The simulated world (MuJoCo, not the tracker's engine), with a noisy depth camera and a tool."""
