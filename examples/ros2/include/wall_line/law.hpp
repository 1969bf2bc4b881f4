// Follows a line on the wall: from time, estimate and measured steering angles to commands for the robot.
// No ROS, no DDS, no clock: the ROS 2 node and the plain Fast DDS program share this law.
// SI units; wheel order FL, BL, BR, FR.
#pragma once

#include <array>

namespace wall_line {

using Four = std::array<double, 4>;

struct Pose {  // of the body in the wall frame
  double x_m = 0, y_m = 0, heading_rad = 0;
};

struct Twist {  // of the body, in its own frame
  double ahead_m_s = 0, left_m_s = 0, turn_rad_s = 0;
};

struct Wheels {
  Four steering_rad{}, drive_rad_s{};
};

struct Line {
  double up_m = 0.3, across_m = 0;  // from where the robot stands at the first estimate, in the wall frame
  double speed_m_s = 0.05, acceleration_m_s2 = 0.05;
};

struct Gains {
  double position_1_s = 2.0, heading_1_s = 2.0;
  double most_m_s = 0.03, most_rad_s = 0.2;  // of the correction
};

struct Modules {
  Four x_m{0.1125, -0.1125, -0.1125, 0.1125}, y_m{0.1125, 0.1125, -0.1125, -0.1125};
  double radius_m = 0.0254, speed_m_s = 0.11, still_m_s = 0.002, steering_rad = 2.09;
};

class Law {
 public:
  Law(const Line &line, const Gains &gains, const Modules &modules);

  // The twist that follows the line; the first call's time (s) and pose are the line's beginning.
  Twist twist(double time_s, const Pose &pose);

  // Whether the reference has reached the end of the line.
  bool done(double time_s) const;

  // Steering angles and drive rates of a twist. Each module takes the nearer of its two angles; a wheel that
  // hardly moves keeps its angle; one that is still turning there drives as far as it already points there.
  Wheels wheels(const Twist &twist, const Four &measured_steering_rad);

 private:
  Line line_;
  Gains gains_;
  Modules modules_;
  Pose begin_;
  double begin_s_ = 0;
  bool begun_ = false, holds_ = false;
  Four held_{};
};

}  // namespace wall_line
