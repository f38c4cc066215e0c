"""The programs on a car: the loop in real time, its processes, the learner, the panel, the replay."""
