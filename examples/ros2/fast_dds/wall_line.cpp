// The controller of ../src/node.cpp without ROS: the same law, on plain Fast DDS 2.
//
//   wall_line_dds [--domain N] [--commands joints|twist] [--topic /joint_commands] [--up M] [--across M]
//                 [--speed M_S]
//
// Every estimate on /odom is answered with one command. Prints `ready`, `begun` at the first one, and `done`
// at the end of the line. Runs until SIGINT or SIGTERM.
#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <optional>
#include <stdexcept>
#include <string>

#include <fastdds/dds/core/condition/WaitSet.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include "messages.hpp"
#include "wall_line/joints.hpp"
#include "wall_line/law.hpp"

namespace fast = eprosima::fastdds::dds;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

std::atomic<bool> ended{false};

struct Options {
  int domain = 0;
  bool joints = true;
  std::string topic;
  wall_line::Line line;
};

Options read_options(int count, char **words) {
  Options o;
  if (const char *domain = std::getenv("ROS_DOMAIN_ID"); domain && *domain) o.domain = std::stoi(domain);
  for (int i = 1; i < count; i += 2) {
    const std::string option = words[i];
    if (i + 1 == count) throw std::invalid_argument(option + " needs a value");
    const std::string value = words[i + 1];
    if (option == "--domain") o.domain = std::stoi(value);
    else if (option == "--commands" && (value == "joints" || value == "twist")) o.joints = value == "joints";
    else if (option == "--topic") o.topic = value;
    else if (option == "--up") o.line.up_m = std::stod(value);
    else if (option == "--across") o.line.across_m = std::stod(value);
    else if (option == "--speed") o.line.speed_m_s = std::stod(value);
    else throw std::invalid_argument(option + " " + value + " is not understood");
  }
  if (o.topic.empty()) o.topic = o.joints ? "/joint_commands" : "/cmd_vel";
  return o;
}

// A participant whose topics have the names and the quality of service that ROS 2 gives them.
class Bus {
 public:
  explicit Bus(int domain) {
    auto *factory = fast::DomainParticipantFactory::get_instance();
    participant_ = factory->create_participant(domain, fast::PARTICIPANT_QOS_DEFAULT);
    if (!participant_) throw std::runtime_error("domain " + std::to_string(domain) + " cannot be joined");
    publisher_ = participant_->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
    subscriber_ = participant_->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
  }

  ~Bus() {
    participant_->delete_contained_entities();
    fast::DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }

  template <class Message>
  fast::DataReader *reader(const std::string &name) {
    fast::DataReaderQos qos = fast::DATAREADER_QOS_DEFAULT;
    as_ros(qos);
    return subscriber_->create_datareader(topic<Message>(name), qos);
  }

  template <class Message>
  fast::DataWriter *writer(const std::string &name) {
    fast::DataWriterQos qos = fast::DATAWRITER_QOS_DEFAULT;
    as_ros(qos);
    return publisher_->create_datawriter(topic<Message>(name), qos);
  }

 private:
  template <class Message>
  fast::Topic *topic(const std::string &name) {
    fast::TypeSupport type(new wall_line::MessageType<Message>());
    type.register_type(participant_);
    if (auto *known = dynamic_cast<fast::Topic *>(participant_->lookup_topicdescription("rt" + name))) return known;
    return participant_->create_topic("rt" + name, Message::kType, fast::TOPIC_QOS_DEFAULT);
  }

  template <class Qos>
  static void as_ros(Qos &qos) {
    qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 10;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
  }

  fast::DomainParticipant *participant_ = nullptr;
  fast::Publisher *publisher_ = nullptr;
  fast::Subscriber *subscriber_ = nullptr;
};

template <class Message>
bool take(fast::DataReader *reader, Message &message) {
  fast::SampleInfo info;
  while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK)
    if (info.valid_data) return true;
  return false;
}

void run(const Options &o) {
  Bus bus(o.domain);
  auto *states = bus.reader<wall_line::JointState>("/joint_states");
  auto *estimates = bus.reader<wall_line::Odometry>("/odom");
  auto *commands =
      o.joints ? bus.writer<wall_line::JointState>(o.topic) : bus.writer<wall_line::Twist3>(o.topic);
  if (!states || !estimates || !commands) throw std::runtime_error("a topic cannot be opened");
  fast::WaitSet waiting;
  fast::StatusCondition &arrived = estimates->get_statuscondition();
  arrived.set_enabled_statuses(fast::StatusMask::data_available());
  waiting.attach_condition(arrived);
  wall_line::Law law(o.line, wall_line::Gains{}, wall_line::Modules{});
  std::optional<wall_line::Four> steering_rad;
  bool fresh = false;  // whether joint states came since the last answer
  wall_line::JointState state;
  bool begun = false, reported = false;
  std::cout << "ready" << std::endl;
  while (!ended) {
    fast::ConditionSeq found;
    waiting.wait(found, eprosima::fastrtps::Duration_t(0, 100'000'000));
    wall_line::Odometry estimate;
    while (take(estimates, estimate)) {
      while (take(states, state)) {  // the bench sends them before its estimate
        steering_rad = wall_line::steering_of(state);
        fresh = true;
      }
      if (!steering_rad) continue;
      const double time_s = estimate.stamp.sec + 1e-9 * estimate.stamp.nanosec;
      const double *q = estimate.quaternion_xyzw, *p = estimate.position_m;
      if (!begun) std::cout << "begun" << std::endl;
      begun = true;
      const auto twist = law.twist(time_s, {p[0], p[1], 2 * std::atan2(q[2], q[3])});
      if (o.joints) {
        wall_line::JointState command;
        command.stamp = fresh ? state.stamp : estimate.stamp;
        wall_line::command(law.wheels(twist, *steering_rad), command);
        commands->write(&command);
      } else {
        wall_line::Twist3 command{{twist.ahead_m_s, twist.left_m_s, 0}, {0, 0, twist.turn_rad_s}};
        commands->write(&command);
      }
      fresh = false;
      if (!reported && law.done(time_s)) {
        reported = true;
        std::cout << "done" << std::endl;
      }
    }
  }
}

}  // namespace

int main(int count, char **words) {
  std::signal(SIGINT, [](int) { ended = true; });
  std::signal(SIGTERM, [](int) { ended = true; });
  try {
    run(read_options(count, words));
  } catch (const std::exception &error) {
    std::cerr << "wall_line_dds: " << error.what() << "\n";
    return 2;
  }
  return 0;
}
