/* The controller of examples/ros2_control in a loop, with drives that do what they are commanded: CELL DOF < CYCLES

   Each cycle is a reference and how far the measured state is off the command, for all joints. Prints the commands of
   each cycle, and then how many allocations there were in all updates. */

#include <controller_interface/chainable_controller_interface.hpp>

#include <cmath>
#include <cstdlib>
#include <iostream>

using controller_interface::ChainableControllerInterface;
using controller_interface::CallbackReturn;

std::unique_ptr<ChainableControllerInterface> exported();

static long count; /* the definitions below replace those of the C library in the whole process */
extern "C" {
void *__libc_malloc(std::size_t);
void *__libc_calloc(std::size_t, std::size_t);
void *__libc_realloc(void *, std::size_t);
void *malloc(std::size_t size)
{
    count++;
    return __libc_malloc(size);
}
void *calloc(std::size_t n, std::size_t size)
{
    count++;
    return __libc_calloc(n, size);
}
void *realloc(void *old, std::size_t size)
{
    count++;
    return __libc_realloc(old, size);
}
}

static double number() /* std::cin does not read nan */
{
    std::string word;
    std::cin >> word;
    return std::strtod(word.c_str(), nullptr);
}

int main(int, char **words)
{
    const std::size_t dof = std::strtoul(words[2], nullptr, 10);
    const std::unique_ptr<ChainableControllerInterface> controller = exported();
    std::vector<double> commands(dof), states(dof);
    for (double &state : states)
        state = number();
    controller->update_rate = 50;
    controller->parameters = {{"cell", std::string(words[1])},
                              {"velocity", std::vector<double>(dof, 3.0)},
                              {"tracking_error", std::vector<double>(dof, 1e-3)}};
    controller->on_init();
    if (controller->on_configure({}) != CallbackReturn::ERROR) /* for want of accelerations */
        return 1;
    controller->parameters["acceleration"] = std::vector<double>(dof, 4.0);
    if (controller->on_configure({}) != CallbackReturn::SUCCESS)
        return 2;
    if (controller->state_interface_configuration().names.size() != dof)
        return 3;
    controller->assign(commands.data(), states.data(), dof);
    if (controller->on_activate({}) != CallbackReturn::SUCCESS)
        return 4;
    long made = 0;
    for (double first = number(); std::cin; first = number()) {
        for (std::size_t c = 0; c < dof; ++c) {
            const double reference = c == 0 ? first : number();
            if (!std::isnan(reference)) /* otherwise it is late */
                controller->references()[c] = reference;
        }
        for (std::size_t c = 0; c < dof; ++c)
            states[c] += number();
        const long before = count;
        controller->update({}, {});
        made += count - before;
        states = commands;
        for (const double command : commands)
            std::printf("%.17g ", command);
        std::puts("");
    }
    std::printf("%ld\n", made);
    return count > 0 ? 0 : 5;
}
