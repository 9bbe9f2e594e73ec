"""The planar 3-PRP machine of the thesis (section 2.3): kinematics, singular poses, workspace, geometry."""
