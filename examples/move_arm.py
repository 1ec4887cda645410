"""Reserve an arm, move its wrist down and up along a line, and use the gripper.

Power, brakes and the reservation are undone at the end, also after a failure or Ctrl-C.
"""

from im import Machine, Pose

with Machine.connect() as im, im.left.reserved(lease=30) as arm:
    start = arm.tool_pose
    print("wrist at", start.position.round(3))
    arm.move_joints(left_j6=0.3)
    arm.move_to(Pose(start.position - (0.0, 0.0, 0.05)), straight=True, speed_scale=0.5)
    print("wrist at", arm.tool_pose.position.round(3))
    print(f"gripper open by {1000 * arm.gripper.close(force=20):.0f} mm")
    print(f"gripper open by {1000 * arm.gripper.open():.0f} mm")
    arm.move_to(start)
