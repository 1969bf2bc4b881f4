// Between sensor_msgs/JointState, of ROS 2 or of plain Fast DDS, and the four modules.
#pragma once

#include <algorithm>
#include <array>
#include <optional>
#include <string>

#include "wall_line/law.hpp"

namespace wall_line {

inline const std::array<std::string, 4> kSteers{"steer_FL", "steer_BL", "steer_BR", "steer_FR"};
inline const std::array<std::string, 4> kDrives{"drive_FL", "drive_BL", "drive_BR", "drive_FR"};

// Steering angles of a state; none where one is missing.
template <class JointState>
std::optional<Four> steering_of(const JointState &state) {
  Four found{};
  for (std::size_t i = 0; i < 4; ++i) {
    const auto at = std::find(state.name.begin(), state.name.end(), kSteers[i]);
    const std::size_t place = at - state.name.begin();
    if (at == state.name.end() || place >= state.position.size()) return std::nullopt;
    found[i] = state.position[place];
  }
  return found;
}

// Fills a command as ros2_control's topic-based hardware does: all joints by name, a position for each that
// is steered, a velocity for each that is driven, in the order of the names.
template <class JointState>
void command(const Wheels &wheels, JointState &filled) {
  filled.name.assign(kSteers.begin(), kSteers.end());
  filled.name.insert(filled.name.end(), kDrives.begin(), kDrives.end());
  filled.position.assign(wheels.steering_rad.begin(), wheels.steering_rad.end());
  filled.velocity.assign(wheels.drive_rad_s.begin(), wheels.drive_rad_s.end());
}

}  // namespace wall_line
