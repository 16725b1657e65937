// Stand-in for the parts of ros2_control and rclcpp that the controller uses: signatures, and as little behind them as
// a test needs.
#pragma once

#include <any>
#include <cstdint>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#define RCLCPP_ERROR(logger, ...) (static_cast<void>(logger), std::fprintf(stderr, __VA_ARGS__))

namespace rclcpp {
struct Time {};
struct Duration {};
struct Logger {};
} // namespace rclcpp

namespace rclcpp_lifecycle {
struct State {};
struct LifecycleNode {
    rclcpp::Logger get_logger() const { return {}; }
};
} // namespace rclcpp_lifecycle

namespace hardware_interface {
struct LoanedStateInterface {
    const double *value;
    std::optional<double> get_optional() const { return *value; }
};
struct LoanedCommandInterface {
    double *value;
    [[nodiscard]] bool set_value(double wanted)
    {
        *value = wanted;
        return true;
    }
};
} // namespace hardware_interface

namespace controller_interface {
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration {
    interface_configuration_type type = interface_configuration_type::NONE;
    std::vector<std::string> names = {};
};

class ChainableControllerInterface {
public:
    virtual ~ChainableControllerInterface() = default;
    virtual CallbackReturn on_init() = 0;
    virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    return_type update(const rclcpp::Time &time, const rclcpp::Duration &period)
    {
        if (!chained && update_reference_from_subscribers(time, period) != return_type::OK)
            return return_type::ERROR;
        return update_and_write_commands(time, period);
    }
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return std::make_shared<rclcpp_lifecycle::LifecycleNode>(); }
    unsigned get_update_rate() const { return update_rate; }
    template <class T> T auto_declare(const std::string &name, const T &otherwise)
    {
        const auto found = parameters.find(name);
        return found == parameters.end() ? otherwise : std::any_cast<T>(found->second);
    }

    // What the manager of controllers does otherwise, for a test.
    unsigned update_rate = 100;
    bool chained = true;
    std::map<std::string, std::any> parameters;
    std::vector<double> &references() { return reference_interfaces_; }
    void assign(double *commands, const double *states, std::size_t n)
    {
        for (std::size_t k = 0; k < n; ++k) {
            command_interfaces_.push_back({commands + k});
            state_interfaces_.push_back({states + k});
        }
    }

protected:
    virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    virtual return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
    std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
    std::vector<std::string> exported_reference_interface_names_;
    std::vector<double> reference_interfaces_;
};
} // namespace controller_interface
