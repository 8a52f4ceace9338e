// A participant of eProsima Fast DDS, as rmw_fastrtps makes one: it hears Imu and String, and steers. Its messages are (de)serialised by
// fastcdr alone. Arguments: domain, and subnet or localhost: how others are looked for. Says what it heard as JSON.
#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastrtps/utils/IPLocator.h>

#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <string>
#include <thread>
#include <vector>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;

struct Imu {
  int32_t sec = 0;
  uint32_t nanosec = 0;
  std::string frame;
  std::array<double, 4> orientation{};
  std::array<double, 9> orientation_covariance{};
  std::array<double, 3> rate{};
  std::array<double, 9> rate_covariance{};
  std::array<double, 3> force{};
  std::array<double, 9> force_covariance{};
  void flow(Cdr &cdr) {
    cdr >> sec >> nanosec >> frame >> orientation >> orientation_covariance >> rate >> rate_covariance >> force >> force_covariance;
  }
  void put(Cdr &) const {}
};

struct Text {
  std::string data;
  void flow(Cdr &cdr) { cdr >> data; }
  void put(Cdr &cdr) const { cdr << data; }
};

struct Numbers {
  std::vector<double> data;
  void flow(Cdr &) {}
  void put(Cdr &cdr) const { cdr << uint32_t(0) << uint32_t(0) << data; }
};

template <class T> class Type : public TopicDataType {
public:
  explicit Type(const char *name) {
    setName(name);
    m_typeSize = 1024;
    m_isGetKeyDefined = false;
  }
  bool serialize(void *data, SerializedPayload_t *payload) override {
    FastBuffer buffer(reinterpret_cast<char *>(payload->data), payload->max_size);
    Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    cdr.serialize_encapsulation();
    static_cast<T *>(data)->put(cdr);
    payload->encapsulation = CDR_LE;
    payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
    return true;
  }
  bool deserialize(SerializedPayload_t *payload, void *data) override {
    FastBuffer buffer(reinterpret_cast<char *>(payload->data), payload->length);
    Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    cdr.read_encapsulation();
    static_cast<T *>(data)->flow(cdr);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void *) override {
    return [] { return 1024u; };
  }
  void *createData() override { return new T(); }
  void deleteData(void *data) override { delete static_cast<T *>(data); }
  bool getKey(void *, InstanceHandle_t *, bool) override { return false; }
};

static DomainParticipant *participant;

template <class T> static Topic *topic(const char *name, const char *type) {
  TypeSupport(new Type<T>(type)).register_type(participant);
  return participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
}

template <class Condition> static void until(Condition condition, const char *what) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) {
      std::fprintf(stderr, "it does not come: %s\n", what);
      std::exit(1);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

int main(int, char **argv) {
  const int domain = std::atoi(argv[1]);
  DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
  if (std::string(argv[2]) == "localhost") { // peers of this machine alone, as ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST has it
    auto &builtin = qos.wire_protocol().builtin;
    for (uint32_t index = 0; index < 32; ++index) {
      eprosima::fastrtps::rtps::Locator_t locator;
      eprosima::fastrtps::rtps::IPLocator::setIPv4(locator, "127.0.0.1");
      locator.port = 7400 + 250 * uint32_t(domain) + 10 + 2 * index;
      builtin.initialPeersList.push_back(locator);
    }
  }
  participant = DomainParticipantFactory::get_instance()->create_participant(domain, qos);
  Subscriber *subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  Publisher *publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
  DataReaderQos best = DATAREADER_QOS_DEFAULT, latched = DATAREADER_QOS_DEFAULT;
  best.reliability().kind = BEST_EFFORT_RELIABILITY_QOS;
  latched.reliability().kind = RELIABLE_RELIABILITY_QOS;
  latched.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
  DataReader *imus = subscriber->create_datareader(topic<Imu>("rt/rov/imu", "sensor_msgs::msg::dds_::Imu_"), best);
  DataReader *modes = subscriber->create_datareader(topic<Text>("rt/rov/mode", "std_msgs::msg::dds_::String_"), latched);
  DataWriter *thrusters = publisher->create_datawriter(
      topic<Numbers>("rt/rov/thrusters/cmd", "std_msgs::msg::dds_::Float64MultiArray_"), DATAWRITER_QOS_DEFAULT);

  SampleInfo info;
  Imu imu;
  int count = 0;
  until([&] {
    while (imus->take_next_sample(&imu, &info) == ReturnCode_t::RETCODE_OK)
      count += info.valid_data;
    return count >= 50;
  }, "imu");
  Text mode;
  until([&] { return modes->take_next_sample(&mode, &info) == ReturnCode_t::RETCODE_OK && info.valid_data; }, "mode");
  PublicationMatchedStatus matched;
  until([&] { return thrusters->get_publication_matched_status(matched) == ReturnCode_t::RETCODE_OK && matched.current_count > 0; },
        "command");
  Numbers numbers;
  numbers.data = {0.1, 0.2, 0.3};
  for (int k = 0; k < 20; ++k) { // until it has matched us too
    thrusters->write(&numbers);
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  std::printf("{\"imus\": %d, \"z\": %.17g, \"frame\": \"%s\", \"sec\": %d, \"mode\": \"%s\"}\n", count, imu.force[2], imu.frame.c_str(),
              imu.sec, mode.data.c_str());
  return 0;
}
