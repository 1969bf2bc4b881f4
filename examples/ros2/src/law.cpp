#include "wall_line/law.hpp"

#include <algorithm>
#include <cmath>

namespace wall_line {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kFlipHysteresis_rad = 0.1;

double wrapped(double angle_rad) { return std::remainder(angle_rad, 2 * kPi); }

// Way and speed along a line of a length, at a time from its beginning: speed up, cruise, slow down.
struct Along {
  double way_m, speed_m_s;
};

double peak_m_s(double length_m, const Line &line) {
  return std::min(line.speed_m_s, std::sqrt(length_m * line.acceleration_m_s2));
}

double duration_s(double length_m, const Line &line) {
  const double peak = peak_m_s(length_m, line);
  return peak > 0 ? length_m / peak + peak / line.acceleration_m_s2 : 0;
}

Along along(double time_s, double length_m, const Line &line) {
  const double peak = peak_m_s(length_m, line), whole_s = duration_s(length_m, line);
  if (peak <= 0 || time_s >= whole_s) return {length_m, 0};
  const double ramp_s = peak / line.acceleration_m_s2, left_s = whole_s - time_s;
  if (time_s < ramp_s) return {line.acceleration_m_s2 * time_s * time_s / 2, line.acceleration_m_s2 * time_s};
  if (left_s < ramp_s)
    return {length_m - line.acceleration_m_s2 * left_s * left_s / 2, line.acceleration_m_s2 * left_s};
  return {peak * (time_s - ramp_s / 2), peak};
}

}  // namespace

Law::Law(const Line &line, const Gains &gains, const Modules &modules)
    : line_(line), gains_(gains), modules_(modules) {}

Twist Law::twist(double time_s, const Pose &pose) {
  if (!begun_) {
    begun_ = true;
    begin_ = pose;
    begin_s_ = time_s;
  }
  const double length_m = std::hypot(line_.up_m, line_.across_m);
  const double up = length_m > 0 ? line_.up_m / length_m : 0, across = length_m > 0 ? line_.across_m / length_m : 0;
  const Along wanted = along(std::max(0.0, time_s - begin_s_), length_m, line_);
  double x_m_s = gains_.position_1_s * (begin_.x_m + up * wanted.way_m - pose.x_m);
  double y_m_s = gains_.position_1_s * (begin_.y_m + across * wanted.way_m - pose.y_m);
  const double share = std::min(1.0, gains_.most_m_s / std::max(std::hypot(x_m_s, y_m_s), 1e-9));
  x_m_s = x_m_s * share + up * wanted.speed_m_s;
  y_m_s = y_m_s * share + across * wanted.speed_m_s;
  const double turn = gains_.heading_1_s * wrapped(begin_.heading_rad - pose.heading_rad);
  const double c = std::cos(pose.heading_rad), s = std::sin(pose.heading_rad);
  return {c * x_m_s + s * y_m_s, c * y_m_s - s * x_m_s,
          std::clamp(turn, -gains_.most_rad_s, gains_.most_rad_s)};
}

bool Law::done(double time_s) const {
  return begun_ && time_s - begin_s_ >= duration_s(std::hypot(line_.up_m, line_.across_m), line_);
}

Wheels Law::wheels(const Twist &twist, const Four &measured_steering_rad) {
  if (!holds_) {
    holds_ = true;
    held_ = measured_steering_rad;
  }
  Four speed_m_s{};
  double fastest_m_s = 0;
  for (int i = 0; i < 4; ++i) {
    const double ahead = twist.ahead_m_s - modules_.y_m[i] * twist.turn_rad_s;
    const double left = twist.left_m_s + modules_.x_m[i] * twist.turn_rad_s;
    double speed = std::hypot(ahead, left);
    if (speed < modules_.still_m_s) continue;
    const double measured = measured_steering_rad[i];
    double angle = measured + wrapped(std::atan2(left, ahead) - measured);
    if (std::abs(angle - measured) > kPi / 2 + kFlipHysteresis_rad) {
      angle -= std::copysign(kPi, angle - measured);
      speed = -speed;
    }
    if (std::abs(angle) > modules_.steering_rad) {
      angle -= std::copysign(kPi, angle);
      speed = -speed;
    }
    held_[i] = angle;
    speed_m_s[i] = speed * std::max(0.0, std::cos(angle - measured));
    fastest_m_s = std::max(fastest_m_s, std::abs(speed_m_s[i]));
  }
  Wheels found;
  found.steering_rad = held_;
  const double slowed = fastest_m_s > modules_.speed_m_s ? modules_.speed_m_s / fastest_m_s : 1;
  for (int i = 0; i < 4; ++i) found.drive_rad_s[i] = speed_m_s[i] * slowed / modules_.radius_m;
  return found;
}

}  // namespace wall_line
