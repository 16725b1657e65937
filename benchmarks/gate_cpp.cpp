/* Time a gate on chunks: CELL CHUNKS DOF ROWS NEW BRAKE JERK STEPS HOW. CHUNKS has chunks of ROWS configurations, 20 ms
   apart. Each begins with NEW targets; at each tick after that, one is appended. Prints microseconds of processor time of this
   thread, and steps, of new chunks and of ticks that continue; and of the clock alone; and how many there are between powers of two if HOW is
   "histograms". */

#include <loewner.hpp>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iterator>
#include <string>

namespace
{
bool with_histograms = false;

double now()
{
    timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e6 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_nsec);
}

void print(const char *name, std::vector<double> numbers)
{
    std::sort(numbers.begin(), numbers.end());
    const double last = static_cast<double>(numbers.size()) - 1;
    const auto at = [&](double share) { return numbers[static_cast<std::size_t>(share * last)]; };
    std::printf("%-22s %8zu %10.1f %10.1f %10.1f\n", name, numbers.size(), at(0.5), at(0.999), at(1));
    if (!with_histograms)
        return;
    auto from = numbers.begin(); // how many are below 1, 2, 4, ...
    for (double most = 1; from != numbers.end(); most *= 2) {
        const auto to = std::lower_bound(from, numbers.end(), most);
        if (to != from)
            std::printf("  below %.0f: %zu", most, static_cast<std::size_t>(to - from));
        from = to;
    }
    std::printf("\n");
}
} // namespace

int main(int count, char **words)
{
    if (count != 10)
        return 2;
    with_histograms = std::string(words[9]) == "histograms";
    constexpr double dt = 0.02;
    const loewner::Checker checker(words[1]);
    const std::size_t dof = std::stoul(words[3]), rows = std::stoul(words[4]), first = std::stoul(words[5]);
    const double strongest = 5, steep = 2500, joint = 1e-3, rate = 1e-2;
    const std::vector<double> acceleration(dof, strongest), jerk(dof, steep), error(dof, joint), off(dof, rate);
    loewner_gate_options options = {};
    options.brake = std::string(words[6]) == "path" ? LOEWNER_BRAKE_PATH : LOEWNER_BRAKE_JOINTS;
    options.acceleration = acceleration.data();
    options.jerk = std::string(words[7]) == "jerk" ? jerk.data() : nullptr;
    options.joint_error = error.data();
    options.velocity_error = off.data();
    options.steps = std::stoll(words[8]);
    loewner::Gate gate(checker, options, rows);
    std::ifstream file(words[2], std::ios::binary);
    std::vector<char> bytes((std::istreambuf_iterator<char>(file)), {});
    const double *all = reinterpret_cast<const double *>(bytes.data());
    const std::size_t chunks = bytes.size() / sizeof(double) / (rows * dof);
    std::vector<double> anew, anew_steps, on, on_steps, empty, dq(dof);
    std::size_t states[4] = {0, 0, 0, 0};
    for (std::size_t k = 0; k < chunks; k++)
        for (std::size_t tick = 0; tick + first < rows; tick++) {
            const double *q = all + (k * rows + tick) * dof;
            for (std::size_t c = 0; c < dof; c++)
                dq[c] = tick == 0 ? 0 : (q[c] - q[c - dof]) / dt;
            const double begin = now();
            const loewner_gate_answer found = gate.check({q, dof}, dq, {q + dof, first * dof}, dt);
            const double end = now();
            empty.push_back(now() - end);
            (tick == 0 ? anew : on).push_back(end - begin);
            (tick == 0 ? anew_steps : on_steps).push_back(static_cast<double>(found.work));
            states[found.state] += tick == 0;
            if (found.steps == 0)
                break;
        }
    std::printf("%s %s, %s steps; new chunks: %zu go, %zu in part, %zu brake, %zu in contact\n", words[6], words[7],
                words[8], states[0], states[1], states[2], states[3]);
    print("new chunk [us]", anew);
    print("new chunk [steps]", anew_steps);
    print("goes on [us]", on);
    print("goes on [steps]", on_steps);
    print("clock [us]", empty);
    return 0;
}
