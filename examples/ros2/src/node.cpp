// ROS 2 node: follows a line on the wall. Every estimate on /odom is answered with one command, which carries
// the stamp of the joint states that it was reckoned from: so a bench in virtual time knows the answer to each
// cycle, and the run can be repeated.
//
// Parameter `commands`: "joints" sends sensor_msgs/JointState to `joint_commands` as ros2_control's
// topic-based hardware does, "twist" sends geometry_msgs/Twist to `cmd_vel`.
#include <cmath>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>

#include <builtin_interfaces/msg/time.hpp>
#include <geometry_msgs/msg/twist.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

#include "wall_line/joints.hpp"
#include "wall_line/law.hpp"

namespace {

class WallLine : public rclcpp::Node {
 public:
  WallLine() : Node("wall_line"), law_(line(), gains(), wall_line::Modules{}) {
    const auto commands = declare_parameter<std::string>("commands", "joints");
    if (commands == "twist")
      twists_ = create_publisher<geometry_msgs::msg::Twist>("cmd_vel", 10);
    else if (commands == "joints")
      joints_ = create_publisher<sensor_msgs::msg::JointState>("joint_commands", 10);
    else
      throw std::invalid_argument("parameter commands: joints or twist");
    states_ = create_subscription<sensor_msgs::msg::JointState>(
        "joint_states", 10, [this](const sensor_msgs::msg::JointState &state) {
          steering_rad_ = wall_line::steering_of(state);
          stamp_ = state.header.stamp;
        });
    estimates_ = create_subscription<nav_msgs::msg::Odometry>(
        "odom", 10, [this](const nav_msgs::msg::Odometry &estimate) { answer(estimate); });
  }

 private:
  wall_line::Line line() {
    wall_line::Line l;
    l.up_m = declare_parameter("up_m", l.up_m);
    l.across_m = declare_parameter("across_m", l.across_m);
    l.speed_m_s = declare_parameter("speed_m_s", l.speed_m_s);
    l.acceleration_m_s2 = declare_parameter("acceleration_m_s2", l.acceleration_m_s2);
    return l;
  }

  wall_line::Gains gains() {
    wall_line::Gains g;
    g.position_1_s = declare_parameter("position_gain_1_s", g.position_1_s);
    g.heading_1_s = declare_parameter("heading_gain_1_s", g.heading_1_s);
    return g;
  }

  void answer(const nav_msgs::msg::Odometry &estimate) {
    if (!steering_rad_) return;
    const auto &p = estimate.pose.pose.position;
    const auto &q = estimate.pose.pose.orientation;
    const wall_line::Pose pose{p.x, p.y, 2 * std::atan2(q.z, q.w)};
    const auto twist = law_.twist(rclcpp::Time(estimate.header.stamp).seconds(), pose);
    if (twists_) {
      geometry_msgs::msg::Twist command;
      command.linear.x = twist.ahead_m_s;
      command.linear.y = twist.left_m_s;
      command.angular.z = twist.turn_rad_s;
      twists_->publish(command);
      return;
    }
    sensor_msgs::msg::JointState command;
    command.header.stamp = stamp_.value_or(estimate.header.stamp);
    stamp_.reset();
    wall_line::command(law_.wheels(twist, *steering_rad_), command);
    joints_->publish(command);
  }

  wall_line::Law law_;
  std::optional<wall_line::Four> steering_rad_;
  std::optional<builtin_interfaces::msg::Time> stamp_;  // of joint states that came since the last answer
  rclcpp::Publisher<geometry_msgs::msg::Twist>::SharedPtr twists_;
  rclcpp::Publisher<sensor_msgs::msg::JointState>::SharedPtr joints_;
  rclcpp::Subscription<sensor_msgs::msg::JointState>::SharedPtr states_;
  rclcpp::Subscription<nav_msgs::msg::Odometry>::SharedPtr estimates_;
};

}  // namespace

int main(int argc, char **argv) {
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<WallLine>());
  rclcpp::shutdown();
  return 0;
}
