"""Playing a score as a task: observation, reward, termination, Gymnasium environments."""
