/* A chainable controller of ros2_control: what it commands is proven free, and so is the brake behind it. See README.md.

   In each cycle the controller above writes the positions to be at when the cycle ends, such as the next targets of a
   chunk. They become commands if the motion to them and the brake from them are proven; otherwise the brake that was
   proven with the last commands begins, or goes on. It also does where no position was written, or where the robot is
   not measured near its commands. */

#include <controller_interface/chainable_controller_interface.hpp>
#include <loewner.hpp>
#include <pluginlib/class_list_macros.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

namespace loewner_control
{
using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::return_type;
using Vector = std::vector<double>;

constexpr double NONE = std::numeric_limits<double>::quiet_NaN();

class GateController : public controller_interface::ChainableControllerInterface
{
public:
    CallbackReturn on_init() override { return CallbackReturn::SUCCESS; }

    CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
    {
        try {
            make_gate();
        } catch (const std::exception &error) {
            RCLCPP_ERROR(get_node()->get_logger(), "%s", error.what());
            return CallbackReturn::ERROR;
        }
        exported_reference_interface_names_ = names_; /* the base class makes interfaces of these numbers */
        reference_interfaces_.assign(dof_, NONE);
        return CallbackReturn::SUCCESS;
    }

    InterfaceConfiguration command_interface_configuration() const override
    {
        return {controller_interface::interface_configuration_type::INDIVIDUAL, names_};
    }
    InterfaceConfiguration state_interface_configuration() const override { return command_interface_configuration(); }

    /* Begin where the robot is: a brake that has ended. */
    CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
    {
        for (std::size_t c = 0; c < dof_; ++c) {
            command_[c] = positions_[c] = state_interfaces_[c].get_optional().value_or(NONE);
            velocities_[c] = velocity_[c] = times_[0] = braked_ = 0;
            if (!std::isfinite(command_[c]))
                return CallbackReturn::ERROR;
        }
        count_ = 1;
        std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), NONE);
        return CallbackReturn::SUCCESS;
    }

protected:
    /* There are none: outside of a chain, the robot stays where it is. */
    return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) override
    {
        return return_type::OK;
    }

    return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) override
    {
        loewner_gate_answer answer = {};
        const bool is_proven = is_on_command() && /* the function of C, since an exception would allocate memory */
                               loewner_gate_check(gate_->get(), command_.data(), velocity_.data(),
                                                  reference_interfaces_.data(), 1, cycle_, 0.0, &answer) == LOEWNER_OK &&
                               answer.steps == 1 && answer.brake_count <= times_.size();
        if (is_proven)
            take_brake(answer);
        else
            braked_ += cycle_;
        for (std::size_t c = 0; c < dof_; ++c) {
            const double next = is_proven ? reference_interfaces_[c] : braking(c);
            velocity_[c] = (next - command_[c]) / cycle_;
            command_[c] = next;
            static_cast<void>(command_interfaces_[c].set_value(next)); /* if it is busy, the next cycle writes again */
            reference_interfaces_[c] = NONE;                           /* a position is good for one cycle */
        }
        return return_type::OK;
    }

private:
    void make_gate()
    {
        checker_.emplace(auto_declare<std::string>("cell", "cell.lwn"));
        dof_ = checker_->dof();
        cycle_ = 1.0 / get_update_rate();
        const Vector acceleration = numbers("acceleration"), velocity = numbers("velocity");
        Vector error = tracking_error_ = numbers("tracking_error");
        for (std::size_t c = 0; c < dof_; ++c) /* from a brake to the lines between its commands */
            error[c] += acceleration[c] * cycle_ * cycle_ / 8;
        loewner_gate_options options = {};
        options.acceleration = acceleration.data();
        options.velocity = velocity.data();
        options.joint_error = error.data();
        options.steps = auto_declare<std::int64_t>("steps", 20000);
        gate_.emplace(*checker_, options, 1);
        names_.clear();
        for (std::size_t c = 0; c < dof_; ++c)
            names_.push_back(checker_->value_name(static_cast<std::int32_t>(c)) + "/position");
        command_.assign(dof_, 0);
        velocity_.assign(dof_, 0);
        times_.assign(3 * dof_ + 1, 0); /* the most that the brake of a gate has */
        positions_.assign(times_.size() * dof_, 0);
        velocities_.assign(times_.size() * dof_, 0);
    }

    Vector numbers(const std::string &name)
    {
        const Vector found = auto_declare<Vector>(name, Vector());
        if (found.size() != dof_)
            throw std::runtime_error(name + ": expected a number for each joint of the cell");
        return found;
    }

    bool is_on_command() const
    {
        for (std::size_t c = 0; c < dof_; ++c)
            if (!(std::fabs(state_interfaces_[c].get_optional().value_or(NONE) - command_[c]) <= tracking_error_[c]))
                return false; /* also for NaN */
        return true;
    }

    void take_brake(const loewner_gate_answer &answer) /* the gate's memory changes with its next check */
    {
        count_ = answer.brake_count;
        braked_ = 0;
        std::copy_n(answer.times, count_, times_.data());
        std::copy_n(answer.positions, count_ * dof_, positions_.data());
        std::copy_n(answer.velocities, count_ * dof_, velocities_.data());
    }

    /* Where the brake is after `braked_` seconds: on the cubic between two positions with their velocities. */
    double braking(std::size_t c) const
    {
        const auto behind = std::upper_bound(times_.data(), times_.data() + count_, braked_) - times_.data();
        const std::size_t k = static_cast<std::size_t>(behind) - 1, from = k * dof_ + c, to = from + dof_;
        if (k + 1 == count_)
            return positions_[from];
        const double T = times_[k + 1] - times_[k], s = (braked_ - times_[k]) / T;
        return positions_[from] + s * s * (3 - 2 * s) * (positions_[to] - positions_[from]) +
               T * s * (1 - s) * ((1 - s) * velocities_[from] - s * velocities_[to]);
    }

    std::optional<loewner::Checker> checker_;
    std::optional<loewner::Gate> gate_;
    std::vector<std::string> names_;
    std::size_t dof_ = 0, count_ = 0;
    double cycle_ = 0, braked_ = 0; /* seconds; how far the brake is */
    Vector tracking_error_, command_, velocity_, times_, positions_, velocities_;
};

} // namespace loewner_control

PLUGINLIB_EXPORT_CLASS(loewner_control::GateController, controller_interface::ChainableControllerInterface)
