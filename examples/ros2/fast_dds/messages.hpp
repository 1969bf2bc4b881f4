// The ROS 2 messages of this controller on plain Fast DDS: their CDR, and what ROS 2 calls them on DDS.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastdds/dds/topic/TopicDataType.hpp>

namespace wall_line {

struct Stamp {
  int32_t sec = 0;
  uint32_t nanosec = 0;
};

struct JointState {
  static constexpr const char *kType = "sensor_msgs::msg::dds_::JointState_";
  Stamp stamp;
  std::string frame;
  std::vector<std::string> name;
  std::vector<double> position, velocity, effort;

  template <class Archive>
  void fields(Archive &a) { a(stamp.sec), a(stamp.nanosec), a(frame), a(name), a(position), a(velocity), a(effort); }
};

struct Odometry {
  static constexpr const char *kType = "nav_msgs::msg::dds_::Odometry_";
  Stamp stamp;
  std::string frame, child;
  double position_m[3]{}, quaternion_xyzw[4]{}, pose_covariance[36]{};
  double twist[6]{}, twist_covariance[36]{};

  template <class Archive>
  void fields(Archive &a) {
    a(stamp.sec), a(stamp.nanosec), a(frame), a(child);
    for (double &v : position_m) a(v);
    for (double &v : quaternion_xyzw) a(v);
    for (double &v : pose_covariance) a(v);
    for (double &v : twist) a(v);
    for (double &v : twist_covariance) a(v);
  }
};

struct Twist3 {
  static constexpr const char *kType = "geometry_msgs::msg::dds_::Twist_";
  double linear[3]{}, angular[3]{};

  template <class Archive>
  void fields(Archive &a) {
    for (double &v : linear) a(v);
    for (double &v : angular) a(v);
  }
};

// Tells Fast DDS how a message is written and read: CDR version 1, as ROS 2 has it.
template <class Message>
class MessageType : public eprosima::fastdds::dds::TopicDataType {
  using Payload = eprosima::fastrtps::rtps::SerializedPayload_t;
  using Buffer = eprosima::fastcdr::FastBuffer;
  using Cdr = eprosima::fastcdr::Cdr;

 public:
  MessageType() {
    setName(Message::kType);
    m_typeSize = 4096;
    m_isGetKeyDefined = false;
    auto_fill_type_information(false);
    auto_fill_type_object(false);
  }

  bool serialize(void *data, Payload *payload) override {
    Buffer buffer(reinterpret_cast<char *>(payload->data), payload->max_size);
    Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    payload->encapsulation = cdr.endianness() == Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
    try {
      cdr.serialize_encapsulation();
      auto write = [&cdr](auto &field) { cdr << field; };
      static_cast<Message *>(data)->fields(write);
    } catch (const eprosima::fastcdr::exception::Exception &) {
      return false;
    }
    payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
    return true;
  }

  bool deserialize(Payload *payload, void *data) override {
    Buffer buffer(reinterpret_cast<char *>(payload->data), payload->length);
    Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    try {
      cdr.read_encapsulation();
      auto read = [&cdr](auto &field) { cdr >> field; };
      static_cast<Message *>(data)->fields(read);
    } catch (const eprosima::fastcdr::exception::Exception &) {
      return false;
    }
    return true;
  }

  std::function<uint32_t()> getSerializedSizeProvider(void *) override {
    return [this] { return m_typeSize; };
  }
  bool getKey(void *, eprosima::fastrtps::rtps::InstanceHandle_t *, bool) override { return false; }
  void *createData() override { return new Message; }
  void deleteData(void *data) override { delete static_cast<Message *>(data); }
};

}  // namespace wall_line
