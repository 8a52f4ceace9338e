// Hold a depth over TCP with JSON lines: asio (header only) and the standard library, nothing else.
//
//   c++ -std=c++17 -Wall -Wextra -DASIO_STANDALONE -pthread depth_hold.cpp -o depth_hold
//   uwserver run bluerov2_pool --paused
//   ./depth_hold 127.0.0.1 7600 2.0
//
// The world is stepped by this program: 12 ticks of 240 Hz between two commands. For more than this, take a JSON library.
#include <algorithm>
#include <asio.hpp>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <stdexcept>
#include <string>

namespace {

constexpr double kPeriod = 12.0 / 240.0;

class Server {
public:
    Server(const std::string &host, const std::string &port) : socket_(context_)
    {
        asio::ip::tcp::resolver resolver(context_);
        asio::connect(socket_, resolver.resolve(host, port));
        socket_.set_option(asio::ip::tcp::no_delay(true));
    }

    // Send a request and wait for its reply; samples that come meanwhile are kept.
    std::string ask(const std::string &method, const std::string &params)
    {
        const std::string id = std::to_string(++id_);
        const std::string request =
            R"({"jsonrpc":"2.0","id":)" + id + R"(,"method":")" + method + R"(","params":)" + params + "}\n";
        asio::write(socket_, asio::buffer(request));
        for (;;) {
            const std::string line = read_line();
            if (line.find(R"("method":"sample")") != std::string::npos) {
                sample_ = line;
            } else if (line.find(R"("method":)") != std::string::npos) {
                continue; // an event, or the progress of a step
            } else if (line.find(R"("id":)" + id + ",") != std::string::npos ||
                       line.find(R"("id":)" + id + "}") != std::string::npos) {
                if (line.find(R"("error":)") != std::string::npos)
                    throw std::runtime_error("refused: " + line);
                return line;
            }
        }
    }

    // A number of the newest sample.
    bool newest(const std::string &field, double &value) const
    {
        const std::string key = "\"" + field + "\":";
        const std::size_t value_at = sample_.find("\"value\":");
        const std::size_t place = value_at == std::string::npos ? value_at : sample_.find(key, value_at);
        if (place == std::string::npos)
            return false;
        value = std::strtod(sample_.c_str() + place + key.size(), nullptr);
        return true;
    }

private:
    std::string read_line()
    {
        const std::size_t length = asio::read_until(socket_, buffer_, '\n');
        const auto begin = asio::buffers_begin(buffer_.data());
        const std::string line(begin, begin + static_cast<std::ptrdiff_t>(length));
        buffer_.consume(length);
        return line;
    }

    asio::io_context context_;
    asio::ip::tcp::socket socket_;
    asio::streambuf buffer_{16u << 20}; // the longest line that the server sends
    std::string sample_;
    int id_ = 0;
};

double hold(Server &server, double wanted)
{
    server.ask("subscribe", R"({"pattern":"bluerov2/depth","delivery":"latest"})");
    double depth = 0.0, rate = 0.0, sum = 0.0, before = 0.0;
    bool known = false;
    for (int k = 0; k < 600; ++k) {
        server.ask("step", R"({"n":12})");
        if (!server.newest("depth", depth))
            continue;
        rate += known ? 0.3 * ((depth - before) / kPeriod - rate) : 0.0;
        before = depth;
        known = true;
        const double error = std::clamp(wanted - depth, -0.5, 0.5);
        sum = std::clamp(sum + error * kPeriod, -1.0, 1.0);
        const double u = std::clamp(0.6 * error + 0.15 * sum - 0.7 * rate, -1.0, 1.0);
        char value[200];
        std::snprintf(value, sizeof value,
                      R"({"port":"bluerov2/thrusters","value":{"u":[0,0,0,0,%.4f,%.4f,%.4f,%.4f]}})", u, u, u, u);
        server.ask("command", value);
    }
    return depth;
}

} // namespace

int main(int argc, char **argv)
{
    if (argc != 4) {
        std::cerr << "usage: depth_hold HOST PORT DEPTH\n";
        return 2;
    }
    try {
        Server server(argv[1], argv[2]);
        std::printf("depth %.2f m\n", hold(server, std::atof(argv[3])));
        return 0;
    } catch (const std::exception &error) {
        std::cerr << "depth_hold: " << error.what() << "\n";
        return 1;
    }
}
