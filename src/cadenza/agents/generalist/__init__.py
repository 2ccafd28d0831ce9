"""An agent that has learnt from the planner how to correct a plan as it is played."""
