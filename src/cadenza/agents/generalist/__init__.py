"""An agent that has learnt from the planner how a plan has to be corrected as it is played."""
